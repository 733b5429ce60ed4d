# Texts of the pages that set a cell up. Figures come with their unit from the page.

## Around every page
skip = To the content
nav = Pages
nav-run = Run
nav-setup = Set up
nav-system = System
nav-manual = Manual
language = Language
log-out = Log out
steps = The way to a picked part
step-of = Step { $number } of { $count }:
understood = Understood
back = Back
left = Left
right = Right
state-starting = STARTING
state-ready = READY
state-busy = BUSY
state-fault = FAULT
state-setup-by = SETUP by { $name }
state-setup-nobody = SETUP
plc-locked = AUTO_LOCK: the plant runs by this cell
plc-owner = PLC
plc-nobody = no PLC connected
connection-lost = No connection to the cell: trying again

## Steps
step-welcome = Welcome
step-cameras = Cameras
step-light = Light and focus
step-calibrate = Calibrate
step-check = Check
step-teach = Teach
step-try = Try
step-robot = Robot
step-plc = PLC and go live
state-tick = done
state-doubt = look again
state-gap = missing
state-none = not known here

## Who has the cell
lease = Who has the cell
lease-free = The cell measures for the plant. To use its cameras, take it: it then answers no PLC until you give it back.
lease-incomplete = The cell cannot measure yet. Take it to set it up.
lease-locked = The plant runs by this cell (AUTO_LOCK is 1), so nobody can take it. Switch the plant to manual mode first.
lease-yours = You have the cell. It measures nothing for the plant until you give it back.
lease-elsewhere = You have the cell, on another screen. Go on here, and that one watches.
lease-others = { $name } has the cell. You see the same pictures and figures, live.
lease-others-view = { $name } has the cell. You see the same pictures and figures, live; changes need the role engineer.
lease-view = You may look at everything. Changes need the role engineer.
lease-unattended = Nobody looks after the cell. It does not measure until somebody has looked that nobody stands in it.
lease-take = Take the cell
lease-take-over = Take over
lease-continue = Go on here
lease-leave = Give it back
lease-end = End SETUP
idle = { $name }, there was no sign of you for ten minutes, so you may only look. Your password brings your rights back.
idle-wake = I am here
password = Password
ask-take-title = Take the cell?
ask-take = The cell finishes its running cycle, then READY falls: every command of the PLC is refused until you give it back.
ask-take-yes = Take it
ask-over-title = Take over from { $name }?
ask-over = { $name } is told, and can only watch from then on. It is written into the audit.
ask-over-yes = Take over
ask-leave-title = Give the cell back?
ask-leave = Settings go back to the active ones, one test pair is taken, then the cell is READY. Nobody may stand in the cell, and no board may be left in it.
ask-leave-yes = Give it back
ask-end-title = Is nobody in the cell?
ask-end = Only who has looked may say so: after this the cell becomes READY, and the plant may start.
ask-end-yes = I have looked: nobody is in it

## What went wrong: cause and remedy
problem-other = That did not work: { $detail }
problem-unreachable = The cell does not answer. Look at the network cable and the cell PC; the page tries again by itself.
problem-log-in = You are not logged in any more. Log in again.
problem-origin = The browser did not say that this page asked. Open the page by its own address.
problem-setup-refused = This cannot be done now: { $detail }
problem-lease-lost = The cell is no longer yours: { $detail }
problem-lease = The cell is no longer yours: { $detail }
problem-role = Your role does not allow this. Somebody with the role engineer can.
problem-idle = There was no sign of you for ten minutes. Say your password again.
problem-password = This is not the password.
problem-wait = Too many attempts. Wait { $wait_s } s.
problem-invalid = The cell does not take this: { $detail }
problem-unknown = There is no such thing, or not any more. Load the page again.
problem-input = The cell does not take this: { $detail }
problem-storage = The disk of the cell PC is full. Make room, then try again.
problem-gone = This picture is no longer kept. Take a new one.
problem-status-404 = This cell does not offer that. Update edged on the cell PC, and load this page again.
problem-status-500 = The cell made a mistake of its own: look at its log (journalctl -u edged).

## Welcome
welcome-title = { $cell }: set up
welcome-new = Nine steps from unboxed cameras to a picked part. A tick comes from what the cell has, not from what was clicked.
welcome-complete = The cell has all it needs to measure. Each step can be looked at, and done again.
welcome-done = Nothing is missing here.
welcome-facts = What the cell has
welcome-later = Done by commands
welcome-later-why = These steps are not in the browser yet. The manual tells the commands.
next-cameras = Next: the cameras
next-light = Next: light and focus
next-calibrate = Next: calibrate
next-check = Next: check
fact-cameras = Cameras
fact-cameras-found =
    { $count ->
        [0] none found
        [one] one found
       *[other] { $count } found
    }{ $troubled ->
        [0] { "" }
        [one] , one with trouble
       *[other] , { $troubled } with trouble
    }
fact-unknown = not looked at yet
fact-rig = Calibration
fact-rig-sigma = (±{ $sigma } µm where parts were taught)
fact-no-rig = none yet
fact-jobs = Jobs
fact-no-jobs = none yet
fact-plc = PLC
fact-plc-owner = writes from
fact-no-plc = none has written yet
fact-error = Fault
manual-cameras = how to set up cameras
manual-light = how to set up cameras
manual-calibrate = how to calibrate
manual-check = how to verify
manual-teach = how to teach
manual-try = how to operate
manual-robot = how to register the robot
manual-plc = how to connect a PLC

## Live pictures
live-left = Left camera, live
live-right = Right camera, live
live-waiting = Waiting for the first picture.
live-watching = A picture comes as soon as whoever has the cell looks at its cameras.
live-take = No picture: take the cell to see its cameras.

## Cameras
cameras-title = Cameras
cameras-what = Both cameras must be there, without trouble, and each on its own side, seen from the cameras towards the part.
cameras-found = Found
cameras-none = No camera answers. Look at power and network cable; a camera in another subnet is shown too, with what to change.
cameras-again = Search again
is-left = left camera
is-right = right camera
is-neither = not used by this cell
trouble-controlled-by-another-program-or-host = in use by another program or PC: end that one
trouble-wrong-subnet = its address is of another subnet than the network card
wave-title = Which one is left?
wave-what = Wave a hand before the left camera only. The camera before which something moves becomes the left one.
wave-start = I wave now
wave-again = Once more
wave-now = Looking: wave before the left camera now.
wave-nobody = No hand was seen before one camera alone. Go nearer to the left one, and keep away from the other.
wave-right = The left picture moved: the cameras are on their right sides.
wave-swapped = The other picture moved: left and right have been exchanged.
keep-what = This is tried: when you give the cell back it is as before, unless you keep it.
keep = Keep it
kept = Kept.
test-title = Test pair
test-what = One exposure of both cameras. How far apart they were taken decides how fast a part may move.
test-take = Take a test pair
test-left = Test picture of the left camera
test-right = Test picture of the right camera
test-skew = { $skew } ms between the two exposures.
test-together = Close enough for a part that moves.
test-apart = Too far apart for a part that moves: look at the trigger.

## Light and focus
light-title = Light and focus
light-what = Make edges sharp and nothing clipped: first the light, then the rings of the lenses, while you look at what it costs.
light-no-settings = Nothing can be set here: the camera tells no limits, or is not there.
light-no-figures = Figures come with the live pictures.
settings-left = Settings of the left camera
settings-right = Settings of the right camera
setting-exposure-us = Exposure
setting-gain-db = Gain
field-limits = A number from { $low } to { $high } { $unit }
field-number = A number, as 0.5 or 0,5
light-head = Light
light-figures = { $clipped } % clipped, { $dark } % too dark, noise { $noise } and contrast { $contrast } grey values
advice-good = Exposure is good.
advice-less-light = Something is clipped: less exposure or less light. Nothing can be measured there.
advice-more-light = Too dark: longer exposure, or more light.
advice-light-for-gain = Noisy: less gain, and longer exposure or more light instead.
advice-take = Set { $exposure } µs
legend-clipped = clipped
legend-dark = too dark
light-copy = Same settings for the right camera
focus-title = Focus
focus-none = No edges to judge: put a board or a part there.
focus-now = Edges are { $now } px wide
focus-best = best { $best } px
focus-cost =
    { $isFree ->
        [0] This costs nothing in sigma Z.
       *[other] This costs +{ $percent } % in sigma Z.
    }
focus-reset = Forget the best

## Calibrate
calibrate-title = Calibrate
calibrate-what = Hold a calibration board before both cameras, at different places and tilts. edged says which view helps most, and when it is enough.
calibrate-new = Begin another calibration
calibrate-board = Board:
calibrate-looking = Hold the board before both cameras: it is being recognised.
board-title = Which board?
board-recognise = Recognise it in the pictures
board-state = I state it
board-kind = Kind
kind-chessboard = chessboard
kind-charuco = ChArUco
kind-dots = plate of dots
kind-circles = asymmetric circles
board-columns = Inner corners (or marks) in a row
board-rows = Rows of them
board-marker = Edge of one marker
board-dictionary = Dictionary of markers
board-mm = Edge of one square
board-pitch = From mark to mark
board-goal = Goal: a point in the volume to ±
board-proof = Measure the length with a calliper over many squares. Nothing in the pictures can prove it, and every coordinate scales with it.
board-begin = Begin
sigma-unknown =
    { $used ->
        [0] Show the board to both cameras.
        [one] One view. The first figure comes with three.
       *[other] { $used } views. The first figure comes soon.
    }
sigma-now = a point here: ±{ $now } µm now
sigma-then = ±{ $then } with this view
sigma-goal = goal ±{ $goal }
sigma-again = reckoning with the last view …
sigma-reached = reached
sigma-on = go on
sigma-more =
    { $count ->
        [one] about one more
       *[other] about { $count } more
    }
ghost-here = here
ghost-share = { $percent } % in the dashed place
seen-whole = The whole board is seen.
seen-clipped = Parts of the board are overexposed: less light.
board-still = The board is still.
board-moves = Hold the board still for a moment.
auto-start = Take views by itself
auto-stop = Stop taking views
view-take = Take this view now
sound-on = Sound is on
sound-off = Sound is off
ghost-where = Next view:
at-upper-left = top left
at-upper-middle = top, in the middle
at-upper-right = top right
at-middle-left = left
at-middle-middle = in the middle
at-middle-right = right
at-lower-left = bottom left
at-lower-middle = bottom, in the middle
at-lower-right = bottom right
far-near = near
far-middle = at middle distance
far-far = far
far-any = at any distance
tilt-square = square to the left camera
tilt-right-near = its right side towards the cameras
tilt-left-near = its left side towards the cameras
tilt-lower-away = its lower side away
tilt-upper-away = its upper side away
missing-dark = No board: the picture is too dark.
missing-bright = No board: the picture is too bright.
missing-not-found = No whole board is seen.
waits-no-board = Waiting for the board.
waits-no-board-left = The left camera does not see the whole board.
waits-no-board-right = The right camera does not see the whole board.
waits-moving = Waiting for the board to be still.
waits-same = This view is there already: bring the board to the dashed place.
waits-elsewhere = Bring the board to the dashed place.
waits-busy = One moment.
waits-board-unknown = The board is not recognised yet.
why-left-out = Left out by hand.
why-not-found = The board was not found.
why-excluded = It contradicts the other views.
views-title =
    { $count ->
        [one] One view
       *[other] { $count } views
    }
view = View { $name }
view-rms = rms { $rms } px
view-new = being measured
view-heldout = held out { $heldout } px
view-remove = Leave out
view-remove-name = Leave out view { $name }
view-taken = View { $name } taken.
view-refused = View { $name } cannot be used: { $why }
view-removed = View { $name } is left out.
undo = Undo
undone = Undone.
verdict-good = This calibration is good.
verdict-usable = This calibration is usable.
verdict-repeat = Not good enough yet: take more views, then solve again.
redo = Redo
redone = Done again.
solve-title = Solve
solve-what =
    { $used ->
        [one] One view is used.
       *[other] { $used } views are used.
    } Each is also held out once, and predicted from the others.
solve-start = Solve
solve-again = Solve again
solve-running = Solving
solve-cancel = Cancel
solve-done = Solved.
solve-failed = It could not be solved:
solve-cancelled = Cancelled. All views are kept.
solved-rms = Residual, rms
solved-heldout = Held out, rms
solved-sigma = A point in the volume
solved-moved = Points moved against the rig before by
solved-report = Report (new tab)
activate = Use this calibration
activate-title = Use this calibration?
activate-what = It becomes a release of its own. Whatever fails, the old one stays; going back is one step in the list of releases.
activate-note = Why (for whoever looks at it later)
activated = In use, as release { $number }.

## Check
check-title = Check
check-what = Hold a board before both cameras, still and whole. One fresh pair says whether the calibration in use still holds.
check-no-rig = There is no calibration to check yet.
check-other = Another board
check-now = Check now
check-running = Measuring …
check-take = Take the cell to check: its cameras are needed.
check-proof = A board whose mm are wrong by as much as at the calibration looks right. Best is another board, or one measured with a calliper.
check-rows = Rows of both pictures
check-rows-now = { $now } px apart, at most { $limit } px is good
check-px = { $limit } px
check-diagonal = Diagonal of the board
check-length-now = { $error } % (this pair: ± { $spread } %), at most ± { $limit } % is good
check-length-mm = measured { $measured } mm, true { $truth } mm
check-percent = { $limit } %
checked-last = Last check
checked-never = Not checked yet.
checked-before = That was another calibration than the one in use: check again.
checked-ok = The calibration holds.
checked-not-ok = The calibration does not hold.
checked-undecided = This pair cannot tell.
remedy-unseen = Hold the whole board before both cameras, without glare, then check again. Is it the board that is chosen above?
remedy-undecided = The board is too small in these pictures, or not sharp: bring it nearer or take a larger one, then check again.
remedy-rows = The cameras have moved against each other, or a lens has. Tighten what is loose, then calibrate again.
remedy-length = Rows agree and lengths do not. First measure the squares of the board: are the mm above right? If they are, calibrate again.

## The virtual stage of edged demo --stage
stage-title = Virtual stage: your hands in this demo
stage-what = These cameras are virtual. Here you do what hands do in a real cell.
stage-show-board = Hold the board
stage-show-part = Lay the part
stage-show-nothing = Nothing
stage-hand = Bring the board to the dashed place
stage-wave-left = Wave before the left camera
stage-wave-right = Wave before the right camera
stage-ring-left = Ring of the left lens
stage-ring-right = Ring of the right lens
stage-ring = { $turn } of a quarter turn

## System
releases-title = Releases
releases-what = Each release is the cell as it became active. Going back takes its calibration and cameras; jobs and settings stay.
releases-none = None yet: the first comes when a calibration is used.
release = Release { $number }
release-active = in use
release-was = was in use
release-back = Use it again
release-back-to = Use release { $number } again
release-back-done = Release { $number } is in use.
release-ask-title = Use release { $number } again?
release-ask = The cell loads it after the running cycle. If anything fails, the present one stays.
release-reason = Why (for whoever looks at it later)
role-viewer = viewer: looks
role-operator = operator: checks, and ends SETUP
role-engineer = engineer: sets up
users-title = People
users-what = Everybody has a name and a password of their own: the audit says who did what.
user-new = Somebody new
user-name = Name
user-role = Role
user-role-of = Role of { $name }
user-password = First password, { $least } letters at least
user-add = Add
user-added = { $name } may come in.
user-remove = Take out
user-remove-name = Take out { $name }
user-remove-what = Their sessions end at once. What they did stays in the audit.
audit-title = Audit
audit-whole = { $count } deeds; the chain holds: nothing was changed or left out.
audit-broken = The chain does not hold:
audit-time = When
audit-user = Who
audit-what = What
audit-outcome = Outcome
audit-reason = Why
audit-records = Newest deeds
