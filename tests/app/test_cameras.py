"""The configuration's trigger modes in the settings of each camera."""

from __future__ import annotations

import pytest

from edged.adapters.aravis import Action, AravisCamera, AravisSettings, FreeRun, LineTrigger, Output, Software
from edged.app.cameras import Triggering, camera_facts, triggering_of
from edged.cell.stereohead import StereoHead
from edged.config.cameras import TriggerSection
from edged.domain.arrays import SIDES

DEVICES = ("192.0.2.1", "192.0.2.2")


def of(*, external: bool = False, **section: object) -> Triggering:
    """The triggering of both cameras."""
    return triggering_of(TriggerSection.model_validate(section), DEVICES, external=external)


def test_software_is_the_default() -> None:
    """By default each camera gets its own software command."""
    assert Triggering((Software(), Software())) == of()


def test_both_cameras_wait_for_the_same_line() -> None:
    """Line, edge, delay and debounce apply to both cameras."""
    line = LineTrigger("Line3", "falling", 120.0, 20.0)

    assert Triggering((line, line)) == of(
        mode="line", line="Line3", edge="falling", delay_us=120, debounce_us=20
    )


def test_free_running_cameras_get_the_same_rate() -> None:
    """In free run both cameras get the same rate."""
    assert Triggering((FreeRun(12.5), FreeRun(12.5))) == of(mode="free-run", rate_hz=12.5)


@pytest.mark.parametrize("first, follower", [("left", "right"), ("right", "left")])
@pytest.mark.parametrize("first_line", ["", "Line5"])
def test_in_a_chain_the_second_follows_the_firsts_exposure(
    first: str, follower: str, first_line: str
) -> None:
    """In a chain the first camera shows its exposure on an output, and the second one waits for its input."""
    chain = of(mode="chain", first=first, first_line=first_line, output="Line4", line="Line1")
    place = ("left", "right").index(first)

    assert (LineTrigger(first_line) if first_line else Software()) == chain.triggers[place]
    assert LineTrigger("Line1") == chain.triggers[1 - place]
    assert (Output("Line4", "ExposureActive"),) == chain.outputs[place]
    assert () == chain.outputs[1 - place]
    assert follower == chain.follower


def test_one_action_command_is_sent_for_both() -> None:
    """One action command goes to each address, or once to the broadcast address, and the second camera
    waits for it."""
    keys = {"device_key": 5, "group_key": 6, "group_mask": 7}
    waiting = Action(5, 6, 7)

    unicast = of(mode="action", **keys)
    broadcast = of(mode="action", broadcast="192.0.2.255", lead_ms=20, **keys)

    assert Triggering((Action(5, 6, 7, DEVICES), waiting), follower="right") == unicast
    assert (
        Triggering((Action(5, 6, 7, ("192.0.2.255",), 0.02, broadcast=True), waiting), follower="right")
        == broadcast
    )


def test_somebody_elses_action_command_is_only_waited_for() -> None:
    """With an external trigger no action command is sent."""
    assert Triggering((Action(), Action())) == of(mode="action", external=True)


def test_a_camera_that_is_lost_stays_in_the_list() -> None:
    """A lost camera is still listed, as not connected."""
    left, right = (
        AravisCamera(side, AravisSettings(device)) for side, device in zip(SIDES, DEVICES, strict=True)
    )
    head = StereoHead(left, right)

    facts = camera_facts(head)
    assert {"left", "right"} == set(facts)
    assert [["not connected"]] * 2 == [[part["text"] for part in parts] for parts in facts.values()]
