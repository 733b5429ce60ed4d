# Texts of calibrate.js.
calibrate-title = Calibrate
calibrate-what = Hold a calibration board before both cameras, at different places and tilts. edged says which view helps most, and when it is enough.
calibrate-new = Begin another calibration
calibrate-nameless = { $id }, no board yet
calibrate-begun-views =
    { $views ->
        [one] one view
       *[other] { $views } views
    }
calibrate-discard-what = All its views will be gone. The calibration in use stays.
calibrate-board = Board:
calibrate-looking = Hold the board before both cameras, where parts will lie, until it is recognised.
sigma-unknown =
    { $used ->
        [0] Show the board to both cameras.
        [one] One view. The first figure comes with three.
       *[other] { $used } views. The first figure comes soon.
    }
sigma-now = a point here: ±{ $now } µm now
sigma-then = ±{ $next } with this view
sigma-goal = goal ±{ $goal }
sigma-again = calculating with the last view …
sigma-reached = reached
sigma-on = go on
sigma-more =
    { $count ->
        [one] about one more
       *[other] about { $count } more
    }
ghost-here = here
ghost-share = { $percent } % in the dashed place
seen-whole = The whole board is visible.
seen-clipped = Parts of the board are overexposed: less light.
auto-start = Take views automatically
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
missing-not-found = No whole board is visible.
waits-no-board = Waiting for the board.
waits-no-board-left = The left camera does not see the whole board.
waits-no-board-right = The right camera does not see the whole board.
waits-moving = Waiting for the board to be still.
waits-same = This view exists already: bring the board to the dashed place.
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
    } Each is also left out once, and predicted from the others.
solve-start = Solve
solve-again = Solve again
solve-running = Solving
solve-cancel = Cancel
solve-done = Solved.
solve-failed = No solution:
solve-cancelled = Cancelled. All views are kept.
solved-rms = Residual, rms
solved-heldout = Held out, rms
solved-sigma = A point in the volume
solved-moved = Points moved against the previous rig by
solved-report = Report (new tab)
activate = Use this calibration
activate-title = Use this calibration?
activate-note = Calibration, ± { $sigma } µm
activate-what = It becomes a release of its own. If anything fails, the old one stays; you can return to it in the list of releases.
activated = In use, as release { $number }.
other-board = The pictures show another board than the one stated: { $board }. Count where four squares meet, not the squares; begin again with the right one.
problem-calibration-few-views = The board is whole in both pictures of { $found } of { $pairs } views; { $least } are needed, and twenty are good.
problem-calibration-parallel = The board is tilted the same way in all views, so focal length and distance cannot be told apart. Tilt it by 20° to 40°, in a different direction each time.
problem-calibration-one-place = Both pictures come from one place: is it the same camera twice?
problem-calibration-swapped = Left and right are exchanged: wave a hand before the left camera in the step “Cameras”. Cameras mounted upside down look the same.
problem-calibration-moving = Left and right show the board at two places: hold it still until both are taken, and let one signal trigger both cameras.
problem-calibration-contradiction = The views contradict each other: did the board or a camera move between the exposures?
problem-calibration-camera-moved = A camera was moved between the views { $before } and { $after }. Tighten what is loose, and take the views again.
problem-calibration-undetermined = These views do not determine the lenses: tilt the board by 20° to 40°, in a different direction each time, and fill the pictures.
problem-calibration-other-board = The pictures show another board ({ $seen }) than the one stated ({ $stated }). Count where four squares meet, not the squares; begin again with the right one.
