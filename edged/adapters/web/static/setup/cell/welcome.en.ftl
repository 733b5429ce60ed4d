# Texts of welcome.js.
welcome-title = { $cell }: set up
welcome-new = Nine steps from unboxed cameras to a picked part. A tick comes from what the cell has, not from what was clicked.
welcome-complete = The cell has all it needs to measure. Each step can be looked at, and repeated.
welcome-done = Nothing is missing here.
welcome-facts = What the cell has
welcome-later = Done on the command line
welcome-later-why = These steps are not in the browser yet. The manual has the commands.
next-cameras = Next: the cameras
next-light = Next: light and focus
next-calibrate = Next: calibrate
next-check = Next: check
next-teach = Next: teach a part
next-try = Next: try it
next-robot = Next: the robot
next-plc = Next: the PLC, and go live
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
fact-rig-sigma = (±{ $sigma } µm where parts were taught)
fact-no-rig = none yet
fact-no-jobs = none yet
fact-plc = PLC
fact-plc-owner = writes from
fact-no-plc = none has written yet
fact-machine = This machine
fact-machine-new = not examined yet
fact-machine-found = { $bad } bad, { $warn } to look at
fact-machine-look = Look at it
fact-error = Fault
manual-cameras = how to set up cameras
manual-light = how to set up cameras
manual-calibrate = how to calibrate
manual-check = how to verify
manual-teach = how to teach
manual-try = how to operate
manual-robot = how to register the robot
manual-plc = how to connect a PLC
