"""Metrics of the cell for Prometheus, in SI units, each with a help text.

They have a registry of their own, so that two cells in one process, or two tests, do not share metrics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    Info,
    ProcessCollector,
    generate_latest,
)
from prometheus_client.core import GaugeMetricFamily, Metric

from edged import __version__
from edged.domain.cell import CellPhase, CellState
from edged.domain.events import CommandFailed, Event, Snapshot
from edged.domain.measurement import Reject, Status
from edged.errors import CaptureError
from edged.payload import reject_names

STAGE_BUCKETS_S = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)

Figures = Callable[[], Mapping[str, tuple[str, float]]]
"""Returns (help text, current value) by name without prefix."""


class MetricsPublisher:
    """Counts events (`edged.ports.Publisher`); `render` returns the response to /metrics.

    more : metrics of other parts of the daemon, read at each `render`.
    """

    def __init__(self, cell: str, more: Figures = dict) -> None:
        self._registry = registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        registry.register(_More(more))
        build = Info("edged_build", "version that runs and its cell", registry=registry)
        build.info({"version": __version__, "cell": cell})
        self._cycles = Counter("edged_cycles", "cycles by how they ended", ["status"], registry=registry)
        for status in Status:
            self._cycles.labels(str(status))
        self._rejected = Counter(
            "edged_rejected_targets", "targets that were not good, by reason", ["reason"], registry=registry
        )
        for bit in Reject:
            self._rejected.labels(str(bit.name))
        self._failed = Counter(
            "edged_failed_commands", "commands that could not be carried out", registry=registry
        )
        self._faults = Counter("edged_faults", "faults of the cameras by code", ["code"], registry=registry)
        for code in sorted(set(_codes(CaptureError))):  # from 0, or the first one shows no increase
            self._faults.labels(str(code))
        self._stages = Histogram(
            "edged_stage_seconds",
            "duration of each stage of a cycle",
            ["stage"],
            buckets=STAGE_BUCKETS_S,
            registry=registry,
        )
        gauges = {
            "ready": ("1 when the cell measures on demand", ""),
            "cameras_ok": ("1 when both cameras deliver", ""),
            "setup": ("1 while somebody sets the cell up, or it lacks calibration or jobs", ""),
            "missed_triggers": ("triggers that came while nothing more could be queued", ""),
            "last_result_timestamp": (
                "exposure of the newest good result, since 1970 UTC",
                "seconds",
            ),
            "score": ("visible share of the shape in the newest good result, 0 to 1", ""),
            "epipolar_rms_pixels": ("row difference of corresponding points in the newest good result", ""),
        }
        self._gauges = {
            name: Gauge(f"edged_{name}", help_, unit=unit, registry=registry)
            for name, (help_, unit) in gauges.items()
        }
        self._sigma = Gauge(
            "edged_sigma_meters", "one sigma of the newest good position", ["axis"], registry=registry
        )

    async def start(self) -> None:
        """Do nothing."""

    def announce(self, event: Event) -> None:
        """Update the metrics by an event."""
        if isinstance(event, Snapshot):
            self._count(event)
        elif isinstance(event, CommandFailed):
            self._failed.inc()
        elif isinstance(event, CellState):
            self._gauges["ready"].set(event.ready)
            self._gauges["cameras_ok"].set(event.cameras_ok)
            self._gauges["setup"].set(event.state is CellPhase.SETUP)
            self._gauges["missed_triggers"].set(event.missed_triggers)

    def _count(self, snapshot: Snapshot) -> None:
        self._cycles.labels(str(snapshot.status)).inc()
        if snapshot.status is Status.CAPTURE_FAULT:
            self._faults.labels(str(snapshot.error_code)).inc()
        for stage, duration_ms in snapshot.timing_ms.items():
            self._stages.labels(stage).observe(duration_ms * 1e-3)
        for target in snapshot.targets:
            for reason in reject_names(target.reject):
                self._rejected.labels(reason).inc()
        if snapshot.status is Status.OK:
            best = snapshot.targets[0]
            self._gauges["last_result_timestamp"].set(snapshot.exposed_ns / 1e9)
            self._gauges["score"].set(best.match.score)
            self._gauges["epipolar_rms_pixels"].set(best.epipolar_rms_px)
            for axis, sigma_mm in zip("xyz", best.sigma_mm, strict=True):
                self._sigma.labels(axis).set(sigma_mm * 1e-3)

    def render(self) -> bytes:
        """All metrics in Prometheus' text format 0.0.4."""
        return generate_latest(self._registry)

    async def close(self) -> None:
        """Do nothing."""


class _More:
    """Collector of gauges whose values are queried at each scrape."""

    def __init__(self, figures: Figures) -> None:
        self._figures = figures

    def collect(self) -> Iterable[Metric]:
        for name, (help_, value) in self._figures().items():
            yield GaugeMetricFamily(f"edged_{name}", help_, value=value)


def _codes(kind: type[CaptureError]) -> Iterator[int]:
    yield kind.code
    for special in kind.__subclasses__():
        yield from _codes(special)
