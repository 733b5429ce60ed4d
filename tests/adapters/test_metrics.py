"""The metrics for Prometheus, read with its own parser."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from helpers.snapshots import make_snapshot, make_target
from prometheus_client.parser import text_string_to_metric_families

from edged.adapters.metrics import MetricsPublisher
from edged.domain.cell import CellPhase, CellState, SetupSource
from edged.domain.events import Command, CommandFailed, CommandKind
from edged.domain.measurement import Reject, Status


def samples(metrics: MetricsPublisher) -> dict[tuple[str, tuple[str, ...]], float]:
    """The value for each (name, values of the labels in the order of their names)."""
    return {
        (sample.name, tuple(value for _, value in sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(metrics.render().decode())
        for sample in family.samples
    }


def test_cycles_are_counted_by_their_end() -> None:
    """There is a counter for each status from the start, which counts its cycles."""
    metrics = MetricsPublisher("cell1")
    assert samples(metrics)["edged_cycles_total", ("NO_TARGET",)] == 0

    for status in (Status.OK, Status.OK, Status.NO_TARGET):
        metrics.announce(make_snapshot(1, status))
    metrics.announce(replace(make_snapshot(2, Status.CAPTURE_FAULT), error="cable", error_code=104))

    found = samples(metrics)
    assert found["edged_cycles_total", ("OK",)] == 2
    assert found["edged_cycles_total", ("NO_TARGET",)] == 1
    assert found["edged_faults_total", ("104",)] == 1


def test_units_are_of_the_base() -> None:
    """Values are in metres and seconds."""
    metrics = MetricsPublisher("cell1")
    target = make_target()
    snapshot = make_snapshot(1, Status.OK, (target,), exposed_ns=1_700_000_000_500_000_000)
    metrics.announce(replace(snapshot, timing_ms={"find": 20.0}))

    found = samples(metrics)
    assert np.isclose(found["edged_sigma_meters", ("z",)], target.sigma_mm[2] * 1e-3)
    assert found["edged_last_result_timestamp_seconds", ()] == 1_700_000_000.5
    assert found["edged_stage_seconds_sum", ("find",)] == 0.02
    assert found["edged_stage_seconds_bucket", ("0.02", "find")] == 1
    assert found["edged_stage_seconds_bucket", ("0.01", "find")] == 0


def test_a_bad_result_does_not_refresh_the_good_ones_age() -> None:
    """A bad result does not change the time of the newest good one."""
    metrics = MetricsPublisher("cell1")
    metrics.announce(make_snapshot(1, Status.OK, exposed_ns=10**18))
    bad = make_snapshot(2, Status.LOW_QUALITY, (make_target(Reject.SIGMA_LIMIT),), exposed_ns=2 * 10**18)
    metrics.announce(bad)

    found = samples(metrics)
    assert found["edged_last_result_timestamp_seconds", ()] == 10**9
    assert found["edged_rejected_targets_total", ("SIGMA_LIMIT",)] == 1


def test_state_and_failures_are_shown() -> None:
    """Ready, cameras, missed triggers, failed commands, and figures of other parts have their current
    values."""
    number = [3.0]
    metrics = MetricsPublisher("cell1", lambda: {"recordings": ("recordings on disk", number[0])})
    metrics.announce(CellState(CellPhase.FAULT, False, False, "flange", 1, 7, "cable", 104))
    metrics.announce(CommandFailed(Command(CommandKind.LOCATE, "modbus", 1), "stopping"))
    number[0] = 4.0

    found = samples(metrics)
    assert found["edged_ready", ()] == found["edged_cameras_ok", ()] == 0
    assert found["edged_missed_triggers", ()] == 7
    assert found["edged_failed_commands_total", ()] == 1
    assert found["edged_recordings", ()] == 4


def test_setup_is_told_apart_from_a_fault() -> None:
    """SETUP has a metric of its own, so that alarms can tell it from a fault."""
    metrics = MetricsPublisher("cell1")
    setup = CellState(CellPhase.SETUP, False, False, "flange", 1, 0, setup=SetupSource.PERSON)
    for state, expected in ((setup, 1), (replace(setup, state=CellPhase.READY), 0)):
        metrics.announce(state)
        assert expected == samples(metrics)["edged_setup", ()]


def test_every_figure_has_a_help_text() -> None:
    """Every metric has a help text."""
    metrics = MetricsPublisher("cell1")
    metrics.announce(make_snapshot())
    families = list(text_string_to_metric_families(metrics.render().decode()))

    assert [family.name for family in families if not family.documentation] == []
