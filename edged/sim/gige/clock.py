"""Clock of a virtual camera: free-running with an offset and a drift, or synchronised by PTP.

The PTP master is the host's own UTC, as with a grandmaster on the cell PC.
"""

from __future__ import annotations

import threading
import time

DISABLED, INITIALIZING, UNCALIBRATED, SLAVE, MASTER = 0, 1, 6, 8, 5
PTP_STATES = {
    "Disabled": DISABLED,
    "Initializing": INITIALIZING,
    "Master": MASTER,
    "Uncalibrated": UNCALIBRATED,
    "Slave": SLAVE,
}
"""GenICam PtpStatus; the values are specific to this camera, clients refer to the names."""

READINGS = 5
"""Readings of both host clocks, of which the best is used; each takes a third of a microsecond."""


class DeviceClock:
    """Device time as a function of the host's monotonic clock. Thread-safe.

    offset_s : time shown at power-on. drift_ppm : rate error relative to the host's clock.
    tick_hz : of the time stamps in registers and images. ptp_error_ns : remaining difference from the
    master when locked. ptp_settle_s : time from PtpEnable to locked.
    """

    def __init__(
        self,
        *,
        offset_s: float = 0.0,
        drift_ppm: float = 0.0,
        tick_hz: int = 1_000_000_000,
        ptp_error_ns: int = 0,
        ptp_settle_s: float = 0.0,
    ) -> None:
        self.tick_hz = tick_hz
        self.ptp_error_ns, self.ptp_settle_s = ptp_error_ns, ptp_settle_s
        self._offset_ns = round(offset_s * 1e9)
        self._drift_ppm = drift_ppm
        self._lock = threading.Lock()
        self.power_on()

    def power_on(self) -> None:
        """Restart at the offset, with PTP disabled."""
        with self._lock:
            self._ptp_since_ns: int | None = None
            self._anchor_ns, self._shown_ns = time.monotonic_ns(), self._offset_ns

    def reset(self) -> None:
        """Restart at zero, as by GevTimestampControlReset; without effect while locked to PTP."""
        with self._lock:
            self._anchor_ns, self._shown_ns = time.monotonic_ns(), 0

    def at(self, monotonic_ns: int) -> int:
        """Device time, ns, when the host's monotonic clock shows `monotonic_ns`."""
        with self._lock:
            return self._at(monotonic_ns)

    def ticks(self, device_ns: int) -> int:
        """Device time in ticks, as reported by the camera."""
        return device_ns * self.tick_hz // 10**9

    def monotonic_at(self, ticks: int) -> int:
        """Host monotonic time, ns, at which a locked clock shows this many ticks."""
        return ticks * 10**9 // self.tick_hz - self.ptp_error_ns - utc_minus_monotonic_ns()

    @property
    def drift_ppm(self) -> float:
        """Rate error relative to the host's clock; changing it causes no step."""
        return self._drift_ppm

    @drift_ppm.setter
    def drift_ppm(self, value: float) -> None:
        with self._lock:
            self._go_on_from(time.monotonic_ns())
            self._drift_ppm = value

    def jump(self, seconds: float) -> None:
        """Step the free-running clock."""
        with self._lock:
            self._shown_ns += round(seconds * 1e9)

    @property
    def ptp(self) -> bool:
        """Whether PTP is enabled. When it is switched off, the clock continues without a step."""
        return self._ptp_since_ns is not None

    @ptp.setter
    def ptp(self, enabled: bool) -> None:
        with self._lock:
            if enabled and self._ptp_since_ns is None:
                self._ptp_since_ns = time.monotonic_ns()
            elif not enabled and self._ptp_since_ns is not None:
                self._go_on_from(time.monotonic_ns())
                self._ptp_since_ns = None

    @property
    def locked(self) -> bool:
        """Whether the clock is locked to the PTP master."""
        since_ns = self._ptp_since_ns
        return since_ns is not None and time.monotonic_ns() - since_ns >= self.ptp_settle_s * 1e9

    @property
    def ptp_state(self) -> int:
        """One of `PTP_STATES`."""
        return SLAVE if self.locked else UNCALIBRATED if self.ptp else DISABLED

    @property
    def offset_from_master_ns(self) -> int:
        """Clock minus PTP master, ns; 0 without PTP."""
        if not self.ptp:
            return 0
        now_ns = time.monotonic_ns()
        return self.at(now_ns) - now_ns - utc_minus_monotonic_ns()

    def _at(self, monotonic_ns: int) -> int:
        if self.locked:
            return monotonic_ns + utc_minus_monotonic_ns() + self.ptp_error_ns
        elapsed_ns = monotonic_ns - self._anchor_ns
        return self._shown_ns + elapsed_ns + round(elapsed_ns * self._drift_ppm * 1e-6)

    def _go_on_from(self, monotonic_ns: int) -> None:
        self._anchor_ns, self._shown_ns = monotonic_ns, self._at(monotonic_ns)


def utc_minus_monotonic_ns() -> int:
    """Host UTC minus its monotonic clock, ns.

    The clocks are read one after the other, and a busy machine may be interrupted in between: of a few
    readings the shortest is used.
    """
    return min(_reading() for _ in range(READINGS))[1]


def _reading() -> tuple[int, int]:
    """Duration of one reading, and the difference of the clocks at its middle, ns."""
    before_ns, utc_ns, after_ns = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
    return after_ns - before_ns, utc_ns - (before_ns + after_ns) // 2
