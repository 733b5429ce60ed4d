# Texts of the page that tries a job.

try-title = Try
try-what = Push the part around, as it will lie in production. Every live pair is measured, and nothing of it goes to the PLC.
try-no-rig = There is no calibration yet: without one nothing can be measured.
try-nothing = There is nothing to try yet: teach a part first.
try-which = What to try
try-drafts = Drafts
try-jobs = Jobs of this cell
try-start = Try it live
try-stop = Stop
try-take = Take the cell to try: its cameras are needed.
try-off = Not trying.
try-coming = The first result comes at once.
try-status-ok = Good
try-status-no-target = No part found
try-status-low-quality = Not good
try-why-few-edges = Not enough of it can be seen: is something over it, does it glare, or does it reach beyond a picture?
try-why-residual = Its edges scatter too much: is it dirty, blurred, or another part?
try-why-sigma-limit = Its place is not known well enough: see the map.
try-why-left-right-mismatch = The cameras contradict each other: did it move, or was a camera knocked?
try-why-out-of-volume = It is nearer or farther than the job allows.
try-why-tolerance = A size is not as taught: is it another part?
try-why-ambiguous-rotation = It cannot be told which way it is turned.
try-why-low-score = Too little of it looks as taught.
try-why-calibration = The calibration has drifted: check it.
try-why-ambiguous-edge = The reference may lie on another edge, such as a chamfer.
try-why-out-of-limits = It lies where the robot may not go.
try-why-keep-out = It lies where the robot may not go.
try-why-no-grasp = No grasp of the job lies where the robot may go.
try-why-not-found = Is the part in both pictures, and about as far away as when it was taught?
try-frame-robot = In the robot's frame
try-frame-rig = In the cameras' frame: no robot is registered
try-measured = Measured now
try-whiskers = The thin lines in the pictures are how far each edge lies beside its curve, magnified as their scale says.
try-still = Is sigma honest?
try-still-what = Nothing may move now, part, cameras or light. The scatter of the results is compared with what edged says of each.
try-still-start = Hold still, { $count } pictures
try-still-running = Measuring …
try-still-failed = It could not be told:
try-verdict-honest = The sigma is honest here: { $chi2 }, expected { $low } to { $high }.
try-verdict-larger = The results scatter more than their sigma says: { $chi2 }, expected { $low } to { $high }. Does something move, or does the light flicker?
try-verdict-smaller = The results scatter less than their sigma says: { $chi2 }, expected { $low } to { $high }. The sigma is on the safe side here.
try-verdict-moving = Something moved in these { $count } pictures: hold still and try again.
try-verdict-vanished = The part was gone in some of these { $count } pictures: lay it down and try again.
try-axis = Axis
try-scatter = Scatter
try-edges = Sigma of the edges
try-map-title = What is to be expected where
try-map-what = Worst of X, Y, Z in µm, seen from the cameras, for this job's features with the light as it is.
try-map-usual = Worst of X, Y, Z in µm, seen from the cameras, for this job's features in usual light: as soon as a part is measured, in this one.
try-map-coming = The map is being made …
try-map-none = Nowhere do both cameras see enough of this part.
try-map-beyond =
    { $beyond ->
        [0] Everywhere within the limit of { $limit } µm.
       *[other] At { $beyond } of { $count } places the limit of { $limit } µm is exceeded.
    }
try-map-layer = How far away
try-layer-near = near
try-layer-middle = middle
try-layer-far = far
try-legend-within = within the limit
try-legend-beyond = beyond it
try-legend-covered = a part was good here
try-covered = { $percent } % of the volume has been proved
