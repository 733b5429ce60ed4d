# Texts of the pages that set a cell up. Figures come with their unit from the page.

## Around every page
skip = Skip to content
nav = Pages
nav-run = Run
nav-setup = Set up
nav-jobs = Jobs
nav-cycles = Cycles
nav-marks = Marks
nav-accept = Acceptance
nav-space = 3D
nav-settings = Settings
nav-system = System
nav-manual = Manual
menu = Account and language:
language = Language
log-out = Log out
steps = The way to a picked part
step-of = Step { $number } of { $count }:
foot = Step before and after
understood = Understood
back = Back
left = Left
right = Right
state-starting = STARTING
state-ready = READY
state-busy = BUSY
state-fault = FAULT
state-stopping = STOPPING
state-setup = SETUP
state-setup-by = SETUP by { $name }
state-setup-nobody = SETUP
plc-locked = AUTO_LOCK: the plant relies on this cell
plc-owner = PLC
plc-nobody = no PLC connected
connection-lost = Connection to the cell lost: trying again
field-limits = A number from { $low } to { $high } { $unit }
field-number = A number, such as 0.5 or 0,5

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
state-open = not begun
state-none = not known here

## Who has the cell
lease = Who has the cell
lease-free = The cell measures for the plant. To use its cameras, take it: it then answers no PLC until you give it back.
lease-incomplete = The cell cannot measure yet. Take it to set it up.
lease-locked = The plant relies on this cell (AUTO_LOCK is 1), so nobody can take it. Switch the plant to manual mode first.
lease-yours = You have the cell. It measures nothing for the plant until you give it back.
lease-elsewhere = You have the cell on another screen. Continue here, and that one only watches.
lease-others = { $name } has the cell. You see the same pictures and figures, live.
lease-others-view = { $name } has the cell. You see the same pictures and figures, live; only an engineer can change anything.
lease-view = You may look at everything. Only an engineer can change anything.
lease-unattended = The cell is unattended. It does not measure until somebody has made sure that nobody is inside.
lease-take = Take the cell
lease-take-over = Take over
lease-continue = Continue here
lease-leave = Give it back
lease-end = End SETUP
idle = { $name }, you have been idle for ten minutes, so you may only look. Enter your password to carry on.
idle-wake = I am here
confirm-title = Your password, please
confirm = { $name }, this changes who may do what, or what the cell runs by. Enter your password to go on.
confirm-yes = Go on
password = Password
ask-take-title = Take the cell?
ask-take = The cell finishes its running cycle, then READY drops: every command of the PLC is refused until you give it back.
ask-take-yes = Take it
ask-over-title = Take over from { $name }?
ask-over = { $name } is told, and can only watch from then on. The audit records it.
ask-over-yes = Take over
ask-leave-title = Give the cell back?
ask-leave = The active settings return, a test pair is taken, then the cell is READY. Nobody may be in the cell, and no board may be left in it.
ask-leave-yes = Give it back
ask-end-title = Is nobody in the cell?
ask-end = Confirm only if you have looked: the cell then becomes READY, and the plant may start.
ask-end-yes = I have looked: nobody is in it

## What went wrong: cause and remedy
problem-other = That did not work: { $detail }
problem-unreachable = The cell does not answer. Check the network cable and the cell PC; the page tries again by itself.
problem-page = This page could not be loaded. Reload it once the cell answers.
problem-log-in = You are no longer logged in. Log in again.
problem-origin = The browser did not say which page sent this request. Open the page by its own address.
problem-setup-refused = This cannot be done now: { $detail }
problem-lease-lost = You no longer have the cell: the line above says who does. What you did until then is kept.
problem-lease = You no longer have the cell: the line above says who does. What you did until then is kept.
problem-role = Your role does not allow this. An engineer can do it.
problem-idle = You have been idle for ten minutes. Enter your password again.
problem-password = Wrong password.
problem-confirm = This needs your password once more.
problem-weak-password = This password is guessed too easily. Choose one of several words, without your name.
problem-exists = Somebody has this name already, or one that looks the same.
problem-wait = Too many attempts. Wait { $wait_s } s.
problem-invalid = The cell does not accept this: { $detail }
problem-unknown = This does not exist, or no longer does. Reload the page.
problem-input = The cell does not accept this: { $detail }
problem-storage = The disk of the cell PC is full. Free some space, then try again.
problem-stale = This was changed meanwhile, by somebody else or on another screen. You now see the newer version: check it, then make your change again.
problem-regression = This turns good recorded cycles bad, or was not tested on them. Test it on the page Cycles, and use it from there.
problem-teach-name = This cannot be a name: use letters, digits, “_”, “.” and “-”, beginning with a letter or a digit.
problem-teach-name-taken = There is a job { $name } already: change that one, or choose another name.
problem-teach-number-taken = { $number } is the number of { $name }; { $free } is free.
problem-teach-name-old = Names with this ending belong to jobs that were replaced: choose another one.
problem-image-size =
    The { $side ->
        [left] left
       *[right] right
    } picture has { $found } pixels, and the calibration is of { $wanted }: let the cameras give that again, or calibrate them as they are now.
problem-task-failed = The cell could not finish this. If it happens again, look at its log (journalctl -u edged).
problem-task-too-large = This needs more memory or processor time than the cell may spend on it, and was stopped: use fewer or smaller pictures, or a smaller drawing.
problem-gone = This picture is no longer kept. Take a new one.
problem-status-404 = This cell does not offer that. Update edged on the cell PC, then reload this page.
problem-status-500 = An internal error of the cell: look at its log (journalctl -u edged).

## Live pictures
live-left = Left camera, live
live-right = Right camera, live
live-waiting = Waiting for the first picture.
live-watching = A picture appears once whoever has the cell looks at its cameras.
live-take = No picture: take the cell to see its cameras.

## On several pages
fact-rig = Calibration
fact-jobs = Jobs
keep-what = This is only tried: the old settings return when you give the cell back, unless you keep it.
keep-calibrate = These cameras are only tried. The calibration was made with the former ones: calibrate again, and both become the cell's together.
keep = Keep it
kept = Kept.
board-title = Which board?
board-recognise = Recognise it in the pictures
board-state = State it myself
board-kind = Kind
kind-chessboard = chessboard
kind-charuco = ChArUco
kind-dots = plate of dots
kind-circles = asymmetric circles
board-columns = Inner corners (or marks) per row
board-rows = Number of rows
board-marker = Edge of one marker
board-dictionary = Dictionary of markers
board-mm = Edge of one square
board-pitch = From mark to mark
board-goal = Goal: a point in the volume to ±
board-proof = Measure the length with a calliper over many squares. The pictures cannot prove it, and every coordinate scales with it.
board-begin = Begin
board-begin-auto = Begin, and take views automatically
board-still = The board is still.
board-moves = Hold the board still for a moment.
view = View { $name }

## What becomes a release, and who signs for it
release-note = Why (for whoever looks at it later)
release-making = One moment …
sign-worse =
    { $count ->
        [one] One recorded cycle that was good would become bad.
       *[other] { $count } recorded cycles that were good would become bad.
    }
sign-untried =
    { $count ->
        [one] It was not tested on the recorded cycle that it concerns.
       *[other] It was not tested on the { $count } recorded cycles that it concerns.
    }
sign-look = Look at them
sign-try = Test it on them
sign-what = If this is intended, say why: the reason is kept with the release, and in the audit with your name.
sign-reason = Why this is acceptable
sign = Sign: { $label }

## The virtual stage of edged demo --stage
stage-title = Virtual stage: your hands in this demo
stage-what = These cameras are virtual. Here you do what your hands would do in a real cell.
stage-board = The board is a chessboard of { $columns } × { $rows } inner corners; the edge of one square is { $mm } mm.
stage-show-board = Hold the board
stage-show-part = Lay the part
stage-show-nothing = Nothing
stage-lay = Lay the part somewhere else
stage-truth = The last result is off by { $x } µm in X, { $y } in Y, { $z } in Z.
stage-truth-none = The error appears here once the cell measures the part.
stage-hand = Bring the board to the dashed place
stage-still = Lay the board down
stage-follow = Follow the dashed place
stage-wave-left = Wave before the left camera
stage-wave-right = Wave before the right camera
stage-ring-left = Ring of the left lens
stage-ring-right = Ring of the right lens
stage-ring = { $turn } of a quarter turn

## A picture that is looked at closely
zoom = Zoom
zoom-in = Closer
zoom-out = Farther away
zoom-all = All

## Drafts
draft-begun = Begun before
draft-go-on = Continue
draft-go-on-with = Continue with { $name }
draft-discard = Discard
draft-discard-name = Discard { $name }
draft-discard-title = Discard { $name }?
draft-broken = It can no longer be read.

## Keys
keys = Keyboard
keys-steps = To the step of this number
keys-beside = To the next step, to the one before
keys-main = To the button at the foot
keys-undo = Undo the last change to a draft
keys-redo = Do it again
keys-close = Close what is open
keys-list = This list
keys-ctrl = Ctrl
keys-single = Single keys act (not while you type)

## Faults of cameras, by the PLC's number
fault-other = A fault of the cell.
fault-100 = A camera did not deliver.
fault-101 = A camera is not found, or does not answer: check its cable and its power.
fault-102 = Another computer controls a camera.
fault-103 = A camera refuses a setting.
fault-104 = No image came in time: check the trigger, the light and the cable.
fault-105 = An image came damaged: packets were lost on the network. Check cables and switch, and test the packets on the page “Cameras”.
fault-106 = Two images are not from the same exposure.
fault-107 = A camera was switched off and on.
fault-108 = This is not the camera that was calibrated: cables or addresses were swapped.
fault-109 = A camera sent the same image twice.
fault-110 = A camera sends the same picture again and again.
fault-111 = One camera exposed, and the other did not.
fault-112 = A camera answers, but sends no images.
fault-113 = Something moved between the two exposures, or the light changed: the part must lie still.
measures-again = The cell goes on trying: with the next good pair it measures again.
draft-settings = Chosen, and not in force yet
draft-use = Use these settings
draft-put = Put them in force
draft-discarded = The draft is discarded.
draft-used = The cell runs with these settings.
diff-nothing = nothing
diff-yes = yes
diff-no = no
diff-option = { $name }: { $before } → { $after }
diff-password = { $name }: another password
