# Texts of robot.js and what it is made of.
robot-title = Robot
robot-lead = Where is the cell in the robot's own coordinates? You touch a few places that the cameras see, or drive to a few poses, and type what the robot shows. After each one this page says how good the registration is.
robot-no-rig = There is no calibration yet: calibrate first.
robot-is-fixed = The cell gives its results in the robot's coordinates.
robot-is-flange = The robot carries the cameras, and the cell knows how.
robot-is-none = Not registered yet: results are in the cameras' own coordinates.
robot-is-unknown = Not known yet: the cell has no job to measure by.
robot-stale = The cell's calibration has changed since this registration was begun. Begin another one.
robot-how = How do you want to do it?
robot-mount = Where are the cameras?
robot-mount-fixed = Fixed, beside or above the robot
robot-mount-flange = On the robot
robot-way = How does the robot say where it is?
robot-way-touch = Its tip touches six places. The tip's TCP must be known precisely.
robot-way-poses = It holds a board in ten poses. Nothing is touched, and no TCP is needed.
robot-what-touch = What does the tip touch?
robot-what-held = Which board does the flange hold?
robot-what-lies = Which board lies still before the cameras?
robot-what-part = A part: { $job }
robot-what-board = Another board
robot-brand = Robot
robot-brand-unknown = I do not know how it writes its poses
robot-begin = Begin
robot-program = The robot's own program can do all of this alone, with a few commands to the cell.
robot-program-later = While a person has the cell it takes no commands from robot or PLC: give it back, then start that program. Its poses or points appear here as they come.
robot-program-how = How to do that
robot-walks = The robot's own program is registering the cell: its poses or points appear here as they come.
robot-walked = The robot's own program took these.
robot-new = Begin another one
robot-begun-touch = Touched points
robot-begun-poses = Poses of the flange
robot-begun-samples =
    { $samples ->
        [one] one so far
       *[other] { $samples } so far
    }
robot-discard-what = All its points and poses will be gone. A registration in use stays.
robot-take-cell = Take the cell: its cameras are needed.
robot-taking = The picture is being taken …
robot-name-point = point { $number }
robot-name-pose = pose { $number }

## Touching
robot-touch-title = Point { $number } of { $wanted }
robot-touch-what = Lay the board or the part down, move the robot out of the way, and take a picture. Then leave it where it is, and touch the place under the cross-hairs.
robot-look = Take a picture of it
robot-look-again = It has moved: take a new picture
robot-live = Live pictures
robot-look-none = Nothing to touch was found in this picture.
robot-look-length = The board is { $percent } % longer than stated, by this calibration. Measure its squares: either the size entered here is wrong, or the one stated at the calibration; then calibrate again.
robot-look-wrong = The board is not as long as stated.
robot-look-found = Found: { $count } places.
robot-picture = The picture that was taken. Its cross-hairs are on the place chosen below.
robot-place = Place (the proposed one helps most)
robot-place-mark = mark in row { $row } of 3, column { $column } of 3
robot-place-circle = middle of circle { $name }
robot-place-slot = middle of slot { $name }
robot-place-corner = corner { $name }
robot-place-reference = reference point of the part
robot-touched = touched
robot-touch-now = The tip is exactly at the place under the cross-hairs. What does the robot show?
robot-add = Add this point
robot-point-taken = Added. { $count } points.

## Poses
robot-pose-title = Pose { $number } of { $wanted }
robot-pose-fixed = The flange holds the board: drive it to where both cameras see the whole board, tilted and turned differently from before. Stand still.
robot-pose-flange = The board lies still: drive the cameras to where both see all of it, tilted and turned differently from before. Stand still.
robot-pose-take = Take the picture at this pose
robot-pose-taken = { $name } is taken.
robot-pose-unseen = { $name }: the board was not seen well enough.
robot-bare = { $count } of the pictures still wait for what the robot showed there: enter it in the list below, or paste several lines at once.

## What the robot shows
robot-shown = What the robot shows
robot-paste = or paste it here, in any form: with tabs, commas, brackets, degree signs
robot-clear = Clear
robot-spread = Give { $count } lines to the pictures that wait
robot-stage-shows = Stage: what the virtual robot shows
robot-stage-walk = Stage: robot to its next pose

## What they say
robot-verdict = What they say
robot-judging = (checking …)
robot-good = All of them agree.
robot-sigma = A place among them, in the robot's coordinates (1 σ)
robot-held-out = Largest distance from where all others expect it
robot-held-rms = Distance from where all others expect them, at the board (rms)
robot-limit = { $mm } mm (limit { $limit } mm)
robot-um = ± { $um } µm
robot-mm = { $mm } mm
robot-more = Add another one
robot-scale = The robot's lengths over the cameras' (should be 1)
robot-trouble-too-few = { $count } so far, at least { $least } are needed.
robot-trouble-no-brand = Which make is the robot? Choose it above; what fits best is shown below.
robot-trouble-culprit = { $name } is wrong by { $mm } mm: without it the others agree to { $others } mm. Touch it again, or correct what was typed.
robot-trouble-scale = The robot's lengths differ from the cameras' by { $percent } % (± { $sigma } %). Measure the squares of the calibration board: its stated size is wrong, or the TCP is.
robot-trouble-disagree = They disagree by { $mm } mm, the limit is { $limit } mm, and no single one is to blame. Take more of them, carefully.
robot-trouble-other-reading = These numbers read as { $reading }, lengths in { $unit }, cameras { $mounted }: that is { $whose }. You said { $said }. Read that way, they agree to { $mm } mm.
robot-trouble-on-one-line = The points lie on one line, so the turn about it is unknown. Touch a place beside it.
robot-trouble-same-place = { $one } and { $two } are nearly the same place. Leave one of them out, and touch another.
robot-trouble-turns-missing = The poses do not turn enough: see the sky below.
robot-trouble-other-units = These lengths look like { $unit }: other units than this robot's pendant shows. Is it the right robot?
robot-trouble-mirrored = The points are mirrored: one axis has the wrong sign, or two are swapped.
robot-trouble-calibration = There is no solution from these: { $detail }
robot-trouble-refused = No verdict on them now: { $detail }
robot-nobodys = no robot's usual way
robot-read-so = Read them as { $brand }
robot-advice-more = More of them improve the result and reveal mistakes: six points or ten poses are good.
robot-advice-flat = All points are in one plane. Place the board or the part higher for the next ones: then a mirrored axis shows, too.
robot-advice-all = Turn the flange between the poses: tilt it by 15° to different sides, and turn the wrist.
robot-advice-tilt = The flange has only turned about its own axis. Tilt it by 15° to different sides.
robot-advice-wrist = The flange has only tilted to and fro. Tilt it to the other sides, too, or turn the wrist by 30°.
robot-conventions = How these numbers can be read, best first
robot-reading = Orientation
robot-lengths = Lengths
robot-cameras = Cameras
robot-off = Off by
robot-mounted-fixed = standing still
robot-mounted-flange = carried
robot-reading-vector-rad = a rotation vector in rad
robot-reading-vector-deg = a rotation vector in degrees
robot-reading-zyx-deg = angles about Z, the new Y, the new X, in degrees
robot-reading-zyx-rad = angles about Z, the new Y, the new X, in rad
robot-reading-fixed-deg = angles about the fixed X, Y, Z, in degrees
robot-reading-fixed-rad = angles about the fixed X, Y, Z, in rad
robot-reading-moving-deg = angles about X, the new Y, the new Z, in degrees
robot-reading-moving-rad = angles about X, the new Y, the new Z, in rad
robot-reading-oat-deg = angles O, A, T in degrees
robot-reading-oat-rad = angles O, A, T in rad
robot-reading-scalar-first = a quaternion, scalar first
robot-reading-scalar-last = a quaternion, scalar last
robot-sky = How the flange turned
robot-sky-what = { $count } poses, as seen from the first one.
robot-sky-whole = It turned about different axes: good.
robot-sky-all = It hardly turned: the arrows show how.
robot-sky-tilt = It only turned about its own axis: the arrows show where it should tilt to.
robot-sky-wrist = It only tilted to and fro: the arrow shows the turn of the wrist that is missing.
robot-sky-one = { $name }: tilted by { $tilt }°, turned by { $turn }°
robot-sky-hint = Each number is a pose, as far from the middle as the flange was tilted; its hand shows the turn of the wrist.

## The list
robot-samples = Points and poses ({ $count })
robot-samples-touch = The figure is the distance from where all other points expect this one; the line is the limit. Points beside a wrong one may have large figures, too: the wrong one is named.
robot-samples-poses = The figure is the distance at the board from where all other poses expect it; the line is the limit.
robot-why-culprit = Wrong, if the others are right.
robot-why-left-out = Left out by hand.
robot-why-not-seen = The board was not seen well enough.
robot-why-length = Another length than stated.
robot-why-no-numbers = What did the robot show?
robot-why-misfit = Not as many numbers as this robot shows.
robot-why-outlier = Does not fit the others, and does not count.
robot-edit = Enter
robot-edit-name = Enter what the robot showed at { $name }
robot-remove = Leave out
robot-remove-name = Leave out { $name }
robot-restore = Use again
robot-restore-name = Use again: { $name }
robot-write = Save
robot-undo = Undo
robot-redo = Redo
robot-undone = Undone.
robot-redone = Done again.

## Keeping it
robot-keep = Keep it
robot-keep-what = It is kept beside the calibration, and then checked by one more touch. Nothing in the cell changes yet.
robot-solve = Keep this registration
robot-go = The check: go to this place
robot-go-look = Lay the board or a part before the cameras and take a picture: then you see here where the robot must go.
robot-go-flange = The board lies where it lay at the last pose.
robot-go-there = { $place }, in the robot's own coordinates:
robot-go-slow = Slowly, first 50 mm above it. Then touch the place by eye, and type what the robot shows.
robot-confirm = How far was it off?
robot-off-by = Off by { $mm } mm.
robot-off-more = That is a lot: touch more places, or check the TCP.
robot-activate = Use this registration
robot-activate-title = Use this registration?
robot-note =
    { $brand }, { $count ->
        [one] { $count } sample
       *[other] { $count } samples
    }
robot-activate-what = The cell gives all results in the robot's coordinates from then on. It becomes a release of its own; going back is one tap on the System page.
robot-activated = In use, as release { $number }.
robot-active = In use.

## The map of the robot's error
robot-map = Map of the robot's error
robot-map-what = Each place that the cell gives the robot is shifted by this map. Parts beyond the touched places are refused. The map goes with this registration: register anew, and it is gone.
robot-map-points = Touched places
robot-map-degree = { $count }, a map of degree { $degree }
robot-map-left-out = A place that was left out is off by (rms)
robot-map-from-to = { $held }; without the map { $alone }
robot-map-noise = What the map does not tell (1 σ)
robot-map-hull = They reach over
robot-map-picture = The places from above. Each line shows where the robot was instead, { $times } times too long; the longest is { $um } µm.
robot-um-plain = { $um } µm
