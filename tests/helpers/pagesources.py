"""The sources of a page besides events, each replaceable by a test's function."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from edged.domain.overview import Overview
from edged.plc.registers import Number, Register
from edged.robot.orientations import Convention
from edged.vision.geometry.rectification import Rectification


@dataclass(frozen=True)
class FixedSources:
    """`edged.adapters.web.PageSources` with fixed answers."""

    rectification: Callable[[], Rectification]
    jobs: Callable[[], Sequence[tuple[int, str]]] = tuple
    facts: Callable[[], Mapping[str, Mapping[str, Any]]] = dict
    known_registers: Callable[[], Sequence[tuple[Register, Number]]] = tuple
    convention: Callable[[], Convention] = lambda: Convention.FIXED_XYZ
    overview: Callable[[], Overview] = Overview
    fingerprint: Callable[[], str] = str
    limits: Callable[[], Mapping[int, float]] = dict

    async def registers(self) -> Sequence[tuple[Register, Number]]:
        """Each register with its value."""
        return self.known_registers()
