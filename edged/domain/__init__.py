"""Value types shared by all of edged: frozen, and complete once built.

Conventions (docs/index.md, "Frames and units"): lengths in mm, angles in rad, pixels (x, y)
with an integer at the centre of a pixel, times in ns UTC. Frame `rig` is the left camera
as calibrated (x right, y down, z forward); `robot` is the robot base. A transform is a
(4, 4) float64 named `to_from_source`, so that chains cancel:
`robot_from_rig @ rig_from_part`.
"""
