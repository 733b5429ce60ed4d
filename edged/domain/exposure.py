"""Exposure time and gain of a camera: values and limits."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CameraValues:
    """Values that a camera has, or is to be given. None: no such setting, or unchanged."""

    exposure_us: float | None = None
    gain_db: float | None = None

    def over(self, before: CameraValues) -> CameraValues:
        """Return these values, with those that are None taken from `before`.

        >>> CameraValues(gain_db=3.0).over(CameraValues(500.0, 0.0))
        CameraValues(exposure_us=500.0, gain_db=3.0)
        """
        return CameraValues(
            before.exposure_us if self.exposure_us is None else self.exposure_us,
            before.gain_db if self.gain_db is None else self.gain_db,
        )


@dataclass(frozen=True, slots=True)
class CameraLimits:
    """Smallest and largest value that a camera accepts now. None: no such setting."""

    exposure_us: tuple[float, float] | None = None
    gain_db: tuple[float, float] | None = None

    def problem(self, values: CameraValues) -> str:
        """Return why the camera cannot accept these values; "" if it can.

        >>> CameraLimits((10.0, 1000.0)).problem(CameraValues(exposure_us=5.0))
        'exposure_us: 5 is outside 10 to 1000'
        """
        problems = []
        for name in ("exposure_us", "gain_db"):
            value, limits = getattr(values, name), getattr(self, name)
            if value is None:
                continue
            if limits is None:
                problems.append(f"{name}: the camera has no such setting")
            elif not limits[0] <= value <= limits[1]:
                problems.append(f"{name}: {value:g} is outside {limits[0]:g} to {limits[1]:g}")
        return "; ".join(problems)
