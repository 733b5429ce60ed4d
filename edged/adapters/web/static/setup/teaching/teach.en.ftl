# Texts of the page that teaches a job.

teach-title = Teach
teach-what = Show the part once to both cameras. edged proposes what to measure by, and says at each tap how precise that makes the coordinates.
teach-no-rig = There is no calibration yet: without one no picture has millimetres.

## How one begins
teach-begin = A new part
teach-begin-what = Lay the part where it is to be measured, with nothing else around it.
teach-take = Take the pair
teach-taking = One moment …
teach-take-cell = Take the cell to take a pair: its cameras are needed.
teach-known = Jobs of this cell
teach-known-what = Change one on the pair that it was taught with, or teach it again. It stays as it is until you use the new one.
teach-edit = Change
teach-edit-job = Change { $name }
teach-again = Teach again
teach-again-job = Teach again: { $name }, from a fresh pair

## The draft
teach-undo = Undo
teach-redo = Redo
teach-undone = Undone.
teach-redone = Done again.
teach-other = Another part
teach-discard-what = The pair and all that was chosen on it will be gone. A job that is in use stays.
teach-changes = changes { $job }
teach-proposing = Looking for what can be measured …
teach-trouble = Nothing can be taught from this yet:

## What it is worth
teach-predicted = Expected for this part, where it lies now
teach-predicted-later = Tap the part in the left picture.
teach-predicted-none = What is selected gives no position: take one circle, one slot or two edges at least.
teach-free = not known: cannot be told apart
teach-better = was ± { $before }
teach-worse = was ± { $before }
teach-no-rivals = No other rotation looks like it.
teach-rival = Turned by { $angle }° it looks { $percent } % the same: take a feature that differs there, or its rotation may be wrong.
teach-far-rival = Turned by { $angle }° it looks { $percent } % the same: still told apart.

## The pictures
teach-tools = What a tap in the left picture does
teach-choose = Select features
teach-now-choose = Tap an outline, or the middle of a hole: solid and ticked is taken, dashed is left out.
teach-now-reference = Tap the point whose coordinates are published: edged takes the middle of what is there.
teach-now-gripping = Tap where the gripper is to hold.
teach-picture-left = Left picture. Arrows move a cross, Enter taps there, plus and minus zoom, 0 shows all.
teach-picture-right = Right picture, the same part of it
teach-look = Look
teach-look-at = Look at { $key }
teach-place-reference = reference
teach-place-gripping = grip
teach-place-reference-said = The reference is set.
teach-place-gripping-said = The gripping point is set.

## Where the part is
teach-part = Where the part is
teach-tool-tap = Tap
teach-tool-rectangle = Rectangle
teach-tool-circle = Circle
teach-tool-polygon = Polygon
teach-tool-brush = Erase
teach-tool-tap-what = Tap the part: the region grows to its outline.
teach-tool-rectangle-what = Drag from corner to corner, or tap both.
teach-tool-circle-what = Drag from the middle to the rim, or tap both.
teach-tool-polygon-what = Tap corner after corner; the first one again closes it.
teach-tool-brush-what = Paint over what is not the part, such as a shadow or a label.
teach-cut = Cut out
teach-place = Put one in the middle
teach-close = Close it
teach-no-region = Nothing yet: the whole picture would be learnt.
teach-adds = { $kind } { $shape }
teach-cuts = { $kind } { $shape }, cut out
teach-remove = Remove
teach-remove-shape = Remove shape { $shape }
teach-shape-rectangle = Rectangle
teach-shape-circle = Circle
teach-shape-polygon = Outline
teach-shape-brush = Erased stroke
teach-handle = { $kind } { $shape }, point { $point }: { $x }, { $y } px. Arrows move it.

## Features
teach-features = Features: { $taken } of { $count } taken
teach-features-what = edged measures by what is taken. Leave out what is blurred, or moves on the part.
teach-no-features = They appear once the cell knows where the part is.
teach-take-all = Take all
teach-taken-said = { $key } is taken.
teach-left-said = { $key } is left out.
teach-kind-circle = circle
teach-kind-slot = slot
teach-kind-edge = edge
teach-kind-corner = corner
teach-kind-curve = curve
teach-size-diameter = Ø { $mm } mm
teach-size-length = { $mm } mm long
teach-size-width = { $mm } mm wide
teach-why-not-seen = not seen in this pair
teach-why-left-out = left out by a person
teach-warnings = Please check
teach-warning-cut = The outline is cut off.
teach-warning-round = It is round: its rotation cannot be told.
teach-warning-symmetric = Turned, it looks the same.
teach-warning-confusable = Turned, it looks much the same.
teach-warning-weak = Little contrast: more light, or from the side.
teach-warning-few-points = Few edges: a larger or a sharper part of it would help.
teach-warning-few-levels = Small in the picture: closer cameras would help.
teach-warning-lopsided = One direction is known much worse than the other.
teach-warning-bright-walls = Walls as bright as the face: holes seem too deep.
teach-warning-uneven = Edges of one face do not lie level.
teach-warning-one-pair = One pair does not show how edges are broken.
teach-warning-not-found = It was not found again in its own picture.

## Points and sizes
teach-reference = Reference
teach-reference-what = The point whose coordinates the PLC and the robot get. Suggested: the one known best.
teach-reference-tap = Tap it in the picture
teach-reference-feature = or the middle of
teach-gripping = Gripping point
teach-gripping-what = Where the gripper holds, if elsewhere: from the reference, along the part's own axes.
teach-gripping-tap = Tap it
teach-gripping-type = Type it
teach-gripping-none = No other place
teach-tray = Tray
teach-tray-what = Where parts stand in pockets: rows and columns in equal steps, by the places where a part is reported in its corners.
teach-tray-columns = Columns
teach-tray-rows = Rows
teach-tray-tolerance = Tolerance
teach-tray-first = First pocket
teach-tray-row-end = Last pocket of the first row
teach-tray-column-end = First pocket of the last row
teach-tray-type = Describe a tray
teach-tray-none = No tray
teach-sizes = Sizes to check
teach-sizes-what = Measured on every part. Outside nominal ± tolerance the part is not good.
teach-size-of = From
teach-size-to = To
teach-size-kind = What
teach-size-witness = The size that checks the calibration on each part: always measured.
teach-size-alone = – (its own size)
teach-size-add = Add this size
teach-size-good = within
teach-size-bad = outside
teach-size-remove = Remove the size { $name }
teach-nominal = Nominal
teach-tolerance = Tolerance ±
teach-measure-radius = radius
teach-measure-distance = distance
teach-measure-angle = angle
teach-measure-width = width
teach-measure-length = length
teach-measure-height = height
teach-measure-flatness = flatness

## Its release
teach-job = The job
teach-name = Name
teach-name-wrong = Letters, digits, "_", "." or "-", beginning with a letter or digit
teach-number = Number on the PLC
teach-activate = Use this job
teach-try = Try it first
teach-activate-title = Use { $name }?
teach-activate-what = It becomes a release of its own. If anything fails, the old one stays; you can return to it in the list of releases.
teach-activated = { $name } is in use, as release { $number }.

## What teaches nothing
problem-teach-no-feature = There is no circle, no slot and no straight edge that both cameras see. Lay the part before both, light it, and tap it.
problem-teach-one-sided = What the left picture shows is not found in the right one. Is the part before both cameras, with nothing in between? Otherwise the calibration is of other cameras: check it.
problem-teach-patterned-table = Around the part are the holes of a perforated table, and the part itself shows only circles about one axis, which tell no turn. Lay it on a plain table to teach it, or add its STEP file.
problem-teach-small-region = The selection is empty or tiny: tap the part, or draw around it.
problem-teach-crossing = The lines around the part cross each other: set the corners one after the other around it.
problem-teach-few-edges = The selection shows too few edges. Is the part inside, lit and in focus?
problem-teach-nothing-there = Nothing with a clear outline is there. Draw around the part, or light it so that it differs from the table.
problem-teach-no-pair = This job was taught elsewhere and keeps no pair: teach it from a fresh one.
problem-teach-nothing-left = Nothing is left to measure by: take one circle, one slot or two edges at least.
problem-teach-no-pictures = That cycle has no pictures: the cameras gave none.
problem-teach-other-rig = That cycle was measured with another calibration, and what its pictures show is elsewhere by now. Take a newer one.
problem-teach-further-none = Pair { $pair } does not show this part, once and whole, in both pictures: take another, or remove it.
problem-teach-further-little = All pairs together show too little of the part.
problem-teach-further-needless = This part has too few curves to learn from further pairs: remove them.
problem-teach-further-size = That pair is of another size than the first one.

teach-further = Further pairs
teach-further-what = Machined edges are broken, and a part that lies square to the cameras does not show how. Lay it tilted by 10 to 40 degrees, or light it otherwise, and add that pair.
teach-further-add = Add a pair
teach-further-said = The pair is added.
teach-further-removed = The pair is removed.
teach-further-pair = Pair { $number }
teach-further-remove-pair = Remove pair { $number }
teach-further-open = What its edge breaks are is not settled: each picture tells it anew, and the sigma says how well.
teach-further-none = The edges are sharp.
teach-further-face = Edge breaks of { $width } mm; the edges in the face were taught.
teach-further-wall = Edge breaks of { $width } mm; the edges in the wall were taught.
teach-further-either = Edge breaks of { $width } mm; either edge may have been taught.

## A drawing instead of the region
teach-drawing = Drawing
teach-drawing-what = The job can be learnt from a DXF drawing of the face that the cameras see: it then has the drawing's own sizes. The pair shows where the part lies.
teach-drawing-is = Learnt from { $name }, its face { $depth } mm from the left camera.
teach-drawing-back = A tap on the part, or another region, learns from the pair again.
teach-drawing-more = Unit, distance, layers
teach-drawing-unit = Unit
teach-drawing-unit-own = as the drawing says
teach-drawing-depth = Distance of the face; empty: as the pair shows it
teach-drawing-layers = Layers, separated by commas; empty: all visible ones
teach-drawing-choose = Choose a DXF file
teach-drawing-reading = Reading …
teach-drawing-said = The job is learnt from { $name }.
problem-teach-drawing-no-dxf = This is not a readable DXF drawing. Export it again as DXF.
problem-teach-drawing-unit = The drawing does not state its unit: choose it below “Unit, distance, layers”, and choose the file again.
problem-teach-drawing-layer = The drawing has no such layer. It has: { $there }
problem-teach-drawing-large = This is not the drawing of one part: it has too many shapes, points or bytes. Export its face alone.
problem-teach-drawing-flat = The drawing is not flat: export the face as lines in the x-y plane.
problem-teach-drawing-empty = There is no closed outline in the drawing. Lines, arcs, circles and polylines are read.
problem-teach-drawing-open = An outline is open: it ends at x { $x }, y { $y } mm. Close it, or name the layers of the part.
problem-teach-drawing-branch = No outline closes at x { $x }, y { $y } mm: there is a branch, or a line drawn twice. Correct it, or name the layers of the part.
problem-teach-drawing = The drawing cannot be used: { $detail }
problem-teach-drawing-depth = The pair does not show how far away the face is: state its distance from the left camera.
problem-teach-drawing-unread = The browser could not read this file.
problem-teach-not-as-drawn = Nothing in this pair resembles the drawing. Is it the face that the cameras see, not mirrored, in its unit, at this distance, and is all of it in both pictures?
