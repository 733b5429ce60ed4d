"""A simulated hand that holds a board in front of the cameras, with smooth movements, tremor and misses.

Movements follow minimum jerk (T. Flash, N. Hogan, "The coordination of arm movements", 1985). If the target
changes during a movement, the new movement is superposed on the current one (T. Flash, E. Henis, "Arm
trajectory modifications during reaching towards visual targets", 1991), so that position and speed never
jump.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.geometry.rigid import rotation_matrix, rotation_vector, transform

REACTION_S = 0.25
"""Time from a request to the start of the movement."""
SHORTEST_S = 0.4
"""Shortest duration of a movement."""
MEAN_MM_S, MEAN_RAD_S = 120.0, math.radians(60.0)
REMEMBERED_S = 60.0
"""Movements that ended longer ago are merged into the base pose; earlier times are never queried."""
SAME_MM, SAME_RAD = 10.0, math.radians(6.0)
"""A requested pose that differs by less counts as a repeated request."""
CALMING_S = 0.3
"""Time over which the tremor fades when the hand is laid down."""
WAVES = 4
"""Number of sines that make up the tremor in each of six directions."""
TREMOR_HZ = (5.0, 11.0)
"""Frequency range of a hand's physiological tremor."""


@dataclass(frozen=True, slots=True)
class Skill:
    """Errors of a hand: tremor, and misses of the requested pose.

    tremor_mm : standard deviation of the position along each axis; tremor_rad : about each axis.
    miss_mm, miss_rad : largest deviation from the requested pose, uniformly distributed in a ball.
    corrected : share of the miss that remains each time nearly the same pose is requested again: a person
    sees where the board is and where it should be.
    """

    tremor_mm: float = 0.05
    tremor_rad: float = math.radians(0.03)
    miss_mm: float = 10.0
    miss_rad: float = math.radians(6.0)
    corrected: float = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class _Movement:
    """A movement, from no shift and turn at begin_ns to the whole shift and turn at end_ns."""

    begin_ns: int
    end_ns: int
    shift_mm: FloatArray
    turn_rad: FloatArray

    def share(self, at_ns: int) -> float:
        return minimum_jerk((at_ns - self.begin_ns) / (self.end_ns - self.begin_ns))


class Hand:
    """A hand; every pose is determined by the seed and the timed requests. Thread-safe.

    rig_from_hand : (4, 4) initial pose. Times are UTC ns, as those of exposures.
    """

    def __init__(self, rig_from_hand: FloatArray, *, seed: int = 0, skill: Skill | None = None) -> None:
        self.skill = skill or Skill()
        self._seed = seed
        self._asked = self._again = 0
        self._goal: FloatArray | None = None
        self._base = np.array(rig_from_hand, dtype=np.float64)
        self._movements: list[_Movement] = []
        self._calm: tuple[int, float, float] = (0, 1.0, 1.0)  # time of change, tremor before and after
        rng = np.random.default_rng((seed, 7))
        self._hz = rng.uniform(*TREMOR_HZ, (6, WAVES))
        self._phase = rng.uniform(0.0, 2.0 * math.pi, (6, WAVES))
        self._lock = threading.Lock()

    def move(self, rig_from_hand: FloatArray, at_ns: int) -> None:
        """Request a movement to a pose; it starts after the reaction time and misses."""
        with self._lock:
            self._asked += 1
            rng = np.random.default_rng((self._seed, 8, self._asked))
            goal = np.array(rig_from_hand, dtype=np.float64)
            self._again = self._again + 1 if self._is_same(goal) else 0
            self._goal = goal.copy()
            remains = self.skill.corrected**self._again
            goal[:3, 3] += remains * self.skill.miss_mm * _in_ball(rng)
            goal[:3, :3] = rotation_matrix(remains * self.skill.miss_rad * _in_ball(rng)) @ goal[:3, :3]
            self._forget(at_ns)
            last = self._steady(None)
            shift_mm = goal[:3, 3] - last[:3, 3]
            turn_rad = rotation_vector(goal[:3, :3] @ last[:3, :3].T)
            here = self._steady(at_ns)
            way_mm = float(np.linalg.norm(goal[:3, 3] - here[:3, 3]))
            way_rad = float(np.linalg.norm(rotation_vector(goal[:3, :3] @ here[:3, :3].T)))
            takes_s = max(SHORTEST_S, way_mm / MEAN_MM_S, way_rad / MEAN_RAD_S)
            begin_ns = at_ns + round(REACTION_S * 1e9)
            end_ns = begin_ns + round(takes_s * 1e9)
            self._movements.append(_Movement(begin_ns, end_ns, shift_mm, turn_rad))

    def lay(self, rig_from_hand: FloatArray, at_ns: int) -> None:
        """Put the hand exactly at a pose at once, without tremor."""
        with self._lock:
            self._base = np.array(rig_from_hand, dtype=np.float64)
            self._movements.clear()
            self._goal = None
            self._calm = (at_ns - round(CALMING_S * 1e9), 0.0, 0.0)

    def rest(self, still: bool, at_ns: int) -> None:
        """Lay the held thing down, which ends the tremor, or take it up again."""
        with self._lock:
            self._calm = (at_ns, self._tremor_share(at_ns), 0.0 if still else 1.0)

    @property
    def still(self) -> bool:
        """Whether the held thing was laid down."""
        return self._calm[2] == 0.0

    def moving(self, at_ns: int) -> bool:
        """Whether it is moving or about to move."""
        with self._lock:
            return any(at_ns < movement.end_ns for movement in self._movements)

    def pose(self, at_ns: int) -> FloatArray:
        """Pose rig_from_hand (4, 4) at a time."""
        with self._lock:
            steady, share = self._steady(at_ns), self._tremor_share(at_ns)
        waves = np.sin(2.0 * math.pi * self._hz * (at_ns * 1e-9 % 1e6) + self._phase)
        tremor = share * math.sqrt(2.0 / WAVES) * waves.sum(axis=1)
        shaken = rotation_matrix(self.skill.tremor_rad * tremor[3:]) @ steady[:3, :3]
        return transform(shaken, steady[:3, 3] + self.skill.tremor_mm * tremor[:3])

    def _is_same(self, goal: FloatArray) -> bool:
        """Whether nearly the same pose was requested last."""
        if self._goal is None:
            return False
        turn = float(np.linalg.norm(rotation_vector(goal[:3, :3] @ self._goal[:3, :3].T)))
        return bool(np.linalg.norm(goal[:3, 3] - self._goal[:3, 3]) < SAME_MM and turn < SAME_RAD)

    def _steady(self, at_ns: int | None) -> FloatArray:
        """Pose without tremor at a time; None: when all movements have ended."""
        pose = self._base.copy()
        for movement in self._movements:
            share = 1.0 if at_ns is None else movement.share(at_ns)
            pose[:3, 3] += share * movement.shift_mm
            pose[:3, :3] = rotation_matrix(share * movement.turn_rad) @ pose[:3, :3]
        return pose

    def _forget(self, at_ns: int) -> None:
        """Merge old movements into the base pose, oldest first only, as each turn acts on those before it."""
        while self._movements and self._movements[0].end_ns < at_ns - REMEMBERED_S * 1e9:
            old = self._movements.pop(0)
            self._base[:3, 3] += old.shift_mm
            self._base[:3, :3] = rotation_matrix(old.turn_rad) @ self._base[:3, :3]

    def _tremor_share(self, at_ns: int) -> float:
        since_ns, before, after = self._calm
        return before + (after - before) * minimum_jerk((at_ns - since_ns) / (CALMING_S * 1e9))


def minimum_jerk(share_of_time: float) -> float:
    """Share of the way after a share of the time; 0 before the movement and 1 after it.

    >>> [round(minimum_jerk(t), 6) for t in (-1.0, 0.0, 0.25, 0.5, 1.0, 2.0)]
    [0.0, 0.0, 0.103516, 0.5, 1.0, 1.0]
    """
    t = min(max(share_of_time, 0.0), 1.0)
    return t**3 * (10.0 + t * (6.0 * t - 15.0))


def _in_ball(rng: np.random.Generator) -> FloatArray:
    """A random point (3,), uniform in the unit ball."""
    direction = rng.standard_normal(3)
    return np.asarray(direction / np.linalg.norm(direction) * rng.random() ** (1.0 / 3.0))
