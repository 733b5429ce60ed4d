"""Ten poses for a registration, about the one where the robot stands: the same for every robot.

Turned about two axes across the tool by more than a hand-eye calibration needs, and about its own; shifted so
that the board is seen in other parts of both pictures.
"""

from __future__ import annotations

TURNS_DEG = ((0, 0, 0), (14, 0, 0), (-14, 0, 5), (0, 14, 0), (0, -14, -5),
             (8, 3, 20), (-10, 10, -20), (10, -10, 30), (-10, -10, -30), (0, 0, 40))  # fmt: skip
"""About x, y, z of the tool."""
SHIFTS_MM = ((0, 0, 0), (8, 4, 5), (-8, 4, -5), (8, -4, 5), (-8, -4, -5),
             (0, 6, 8), (0, -6, -8), (10, 0, 0), (-10, 0, 0), (0, 0, 10))  # fmt: skip
"""Along x, y, z of the tool."""
SETTLE_S = 0.5
"""At each pose, before the picture: the arm comes to rest after it has arrived."""
