# Texts of the pages that set a cell up. Figures come with their unit from the page.

## Around every page
skip = To the content
nav = Pages
nav-run = Run
nav-setup = Set up
nav-jobs = Jobs
nav-cycles = Cycles
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
state-stopping = STOPPING
state-setup = SETUP
state-setup-by = SETUP by { $name }
state-setup-nobody = SETUP
plc-locked = AUTO_LOCK: the plant runs by this cell
plc-owner = PLC
plc-nobody = no PLC connected
connection-lost = No connection to the cell: trying again
field-limits = A number from { $low } to { $high } { $unit }
field-number = A number, as 0.5 or 0,5

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
problem-page = This page could not be fetched. Load it again as soon as the cell answers.
problem-log-in = You are not logged in any more. Log in again.
problem-origin = The browser did not say that this page asked. Open the page by its own address.
problem-setup-refused = This cannot be done now: { $detail }
problem-lease-lost = The cell is no longer yours: the line above says whose it is. What you did until then is kept.
problem-lease = The cell is no longer yours: the line above says whose it is. What you did until then is kept.
problem-role = Your role does not allow this. Somebody with the role engineer can.
problem-idle = There was no sign of you for ten minutes. Say your password again.
problem-password = This is not the password.
problem-wait = Too many attempts. Wait { $wait_s } s.
problem-invalid = The cell does not take this: { $detail }
problem-unknown = There is no such thing, or not any more. Load the page again.
problem-input = The cell does not take this: { $detail }
problem-storage = The disk of the cell PC is full. Make room, then try again.
problem-stale = Somebody else, or another screen, changed this meanwhile. You see the newer one now: look at it, then do yours again.
problem-regression = Good recorded cycles become bad by this, or it was not tried on them: do so on the page Cycles, and use it there.
problem-teach-name = This cannot be a name: letters, digits, “_”, “.” and “-” can, the first a letter or a digit.
problem-teach-name-taken = There is a job { $name } already: change that one, or choose another name.
problem-teach-number-taken = { $number } is the number of { $name }; { $free } is free.
problem-teach-name-old = What ends so is a job that was replaced: choose another name.
problem-image-size =
    The { $side ->
        [left] left
       *[right] right
    } picture has { $found } pixels, and the calibration is of { $wanted }: let the cameras give that again, or calibrate them as they are now.
problem-task-failed = The cell's own work on it ended without a result. If that happens again, look at its log (journalctl -u edged).
problem-task-too-large = This took more memory or processor time than the cell may spend on it, and was ended: use fewer or smaller pictures, or a smaller drawing.
problem-gone = This picture is no longer kept. Take a new one.
problem-status-404 = This cell does not offer that. Update edged on the cell PC, and load this page again.
problem-status-500 = The cell made a mistake of its own: look at its log (journalctl -u edged).

## Live pictures
live-left = Left camera, live
live-right = Right camera, live
live-waiting = Waiting for the first picture.
live-watching = A picture comes as soon as whoever has the cell looks at its cameras.
live-take = No picture: take the cell to see its cameras.

## On several pages
fact-rig = Calibration
fact-jobs = Jobs
keep-what = This is tried: when you give the cell back it is as before, unless you keep it.
keep = Keep it
kept = Kept.
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
board-still = The board is still.
board-moves = Hold the board still for a moment.
view = View { $name }

## What becomes a release, and who signs for it
release-note = Why (for whoever looks at it later)
release-making = One moment …
sign-worse =
    { $count ->
        [one] One recorded cycle that was good becomes bad by it.
       *[other] { $count } recorded cycles that were good become bad by it.
    }
sign-untried =
    { $count ->
        [one] It was not tried on the recorded cycle that it concerns.
       *[other] It was not tried on the { $count } recorded cycles that it concerns.
    }
sign-look = Look at them
sign-try = Try it on them
sign-what = If that is as it should be, say why: it is kept with the release, and in the audit with your name.
sign-reason = Why it may be so
sign = Sign: { $label }

## The virtual stage of edged demo --stage
stage-title = Virtual stage: your hands in this demo
stage-what = These cameras are virtual. Here you do what hands do in a real cell.
stage-show-board = Hold the board
stage-show-part = Lay the part
stage-show-nothing = Nothing
stage-lay = Lay the part somewhere else
stage-truth = The last result is off by { $x } µm in X, { $y } in Y, { $z } in Z.
stage-truth-none = As soon as the cell measures the part, its error stands here.
stage-hand = Bring the board to the dashed place
stage-wave-left = Wave before the left camera
stage-wave-right = Wave before the right camera
stage-ring-left = Ring of the left lens
stage-ring-right = Ring of the right lens
stage-ring = { $turn } of a quarter turn

## A picture that is looked at closely
zoom = Zoom
zoom-in = Closer
zoom-out = Further away
zoom-all = All

## Drafts
draft-begun = Begun before
draft-go-on = Go on
draft-go-on-with = Go on with { $name }
draft-discard = Discard
draft-discard-name = Discard { $name }
draft-discard-title = Discard { $name }?
draft-broken = It cannot be read any more.
