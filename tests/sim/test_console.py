"""Commands to running virtual cameras, and their assembly by `edged sim`."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import cv2
import numpy as np
import pytest

from edged.commands.sim import SimOptions, build
from edged.errors import UserError
from edged.sim.console import SimConsole, set_fault
from edged.sim.exposure import ExposureRequest
from edged.sim.gige.camera import GigeCamera, moving_ramp
from edged.sim.gige.faults import Faults


@pytest.fixture
def cameras() -> dict[str, GigeCamera]:
    """Two cameras that are not switched on."""
    return {
        side: GigeCamera(f"127.0.54.{number}", f"C{number}", moving_ramp, size=(64, 48))
        for number, side in enumerate(("left", "right"), 1)
    }


def test_commands_reach_the_cameras_they_name(cameras: dict[str, GigeCamera]) -> None:
    """A command reaches the named camera, or both, and `status` lists the faults of each."""
    console = SimConsole(cameras)
    edges: list[bool] = []
    cameras["right"].line("Line3").listen(lambda level, _: edges.append(level))

    for line in (
        "set left packet_loss 0.25",
        "set both lost_packets 2,7",
        "set right frozen on",
        "set right drop_next 3",
        "pulse right Line3 2.5",
        "temperature both 71.5",
        "drift right -40",
        "steal left",
    ):
        assert "ok" == console.execute(line)

    assert Faults(packet_loss=0.25, lost_packets=(2, 7)) == cameras["left"].faults
    assert Faults(frozen=True, drop_next=3, lost_packets=(2, 7)) == cameras["right"].faults
    assert [True, False] == edges
    assert (71.5, -40.0) == (cameras["left"].temperature_c, cameras["right"].clock.drift_ppm)
    left, right = console.execute("status").splitlines()
    assert left == "left: C1 at 127.0.54.1, controlled, 0 exposures, packet_loss=0.25, lost_packets=(2, 7)"
    assert "free" in right
    assert "frozen=True" in right
    console.execute("clear both")
    assert Faults() == cameras["left"].faults == cameras["right"].faults


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("reboot", "no camera ''; expected left, right or both"),
        ("pulse middle", "no camera 'middle'"),
        ("explode left", "no command 'explode'"),
        ("set left packet_loss", "1 values after left"),
        ("set left packet_loss 1.5", "a number from 0 to 1"),
        ("set left delay_s nan", "a number from 0 to 60"),
        ("set left frozen perhaps", "expected on or off"),
        ("set left lost_packets 1,x", "'x'; expected a number"),
        ("set left colour 1", "no fault 'colour'; expected one of packet_loss"),
        ("pulse left Line9", "no line 'Line9'; expected one of Line1"),
        ("pulse left Line1 -1", "a number from 0"),
        ("move left here", "expected an IPv4 address"),
        ("temperature left hot", "a number from -40 to 120"),
    ],
)
def test_a_wrong_command_says_what_was_expected(
    cameras: dict[str, GigeCamera], line: str, expected: str
) -> None:
    """A wrong command is refused with what was expected, and changes nothing."""
    with pytest.raises(UserError, match=expected):
        SimConsole(cameras).execute(line)
    assert Faults() == cameras["left"].faults


def test_help_names_every_command_and_fault(cameras: dict[str, GigeCamera]) -> None:
    """`help` lists every command and fault."""
    console = SimConsole(cameras)
    text = console.execute("help")

    for name in (*console.verbs, *(field.name for field in fields(Faults))):
        assert name in text
    assert console.execute("") == ""
    assert not console.ended
    console.execute("quit")
    assert console.ended


def test_every_fault_can_be_set_to_what_it_is() -> None:
    """Every fault can be set from text."""
    written = {bool: "on", float: "0.5", int: "3", tuple: "1,2"}
    faults = Faults()
    for field in fields(Faults):
        set_fault(faults, field.name, written[type(getattr(faults, field.name))])

    assert all(getattr(faults, f.name) in (True, 0.5, 3, (1, 2)) for f in fields(Faults))


def test_pictures_of_a_folder_are_shown_in_turn(tmp_path: Path) -> None:
    """Pairs of a folder are shown in turn and from the start again; a region of the sensor is one of the
    picture."""
    for name, grey in (("a", 10), ("b", 20)):
        for side, more in (("left", 0), ("right", 5)):
            cv2.imwrite(str(tmp_path / f"{name}_{side}.png"), np.full((48, 64), grey + more, np.uint8))
    cameras = build(SimOptions(images=tmp_path))

    def seen(side: str, frame_id: int, exposed_ms: int) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
        request = ExposureRequest(frame_id, exposed_ms * 1_000_000, 0, 1.0, 0.0, 32, 16)
        return cameras[side].exposure(request)

    assert [10, 20, 10] == [seen("left", n, 1000 * n)[0, 0] for n in (1, 2, 3)]
    assert seen("right", 2, 2001).shape == (16, 32)
    assert (seen("right", 2, 2001) == 25).all()


def test_both_cameras_show_one_pair_also_after_one_was_unplugged(tmp_path: Path) -> None:
    """Both cameras show the same pair, also after one was unplugged and counts its frames anew."""
    for name, grey in (("a", 10), ("b", 20), ("c", 30)):
        for side in ("left", "right"):
            cv2.imwrite(str(tmp_path / f"{name}_{side}.png"), np.full((48, 64), grey, np.uint8))
    cameras = build(SimOptions(images=tmp_path))

    def seen(side: str, frame_id: int, exposed_ms: int) -> int:
        request = ExposureRequest(frame_id, exposed_ms * 1_000_000, 0, 1.0, 0.0, 64, 48)
        return int(cameras[side].exposure(request)[0, 0])

    before = [(seen("left", n, 1000 * n), seen("right", n, 1000 * n + 3)) for n in (1, 2)]
    alone = seen("right", 3, 3000)  # the left one is unplugged
    after = [(seen("left", n - 3, 1000 * n), seen("right", n, 1000 * n + 3)) for n in (4, 5)]
    assert [(10, 10), (20, 20)] == before
    assert 30 == alone
    assert [(10, 10), (20, 20)] == after


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (SimOptions(pattern="64"), "--pattern"),
        (SimOptions(pattern="64x48", addresses=("none", "none")), "at least one camera"),
        (SimOptions(pattern="64x48", addresses=("127.0.0.3", "")), "an address of its own"),
        (SimOptions(pattern="64x48", addresses=("camera", "")), "'camera' is no IPv4 address"),
        (SimOptions(pattern="64x48", quirks=("odd",)), "expected one of mode-before-source"),
        (SimOptions(pattern="64x48", faults=("frozen",)), "expected NAME=VALUE"),
        (SimOptions(pattern="64x48", faults=("top.frozen=on",)), "expected NAME=VALUE or left"),
        (SimOptions(pattern="64x48", faults=("left.frozen=1",)), "expected on or off"),
    ],
)
def test_a_wrong_option_says_what_was_expected(options: SimOptions, expected: str) -> None:
    """A wrong option is refused before any socket is opened."""
    with pytest.raises(UserError, match=expected):
        build(options)


def test_options_reach_the_cameras_they_are_for() -> None:
    """Options for a side, for the right clock and for an address reach these cameras alone."""
    options = SimOptions(
        pattern="64x48", addresses=("127.0.54.8", ""), faults=("left.delay_s=0.1",), drift_ppm=30.0
    )
    left, right = build(options).values()

    assert (left.address, right.address) == ("127.0.54.8", "127.0.0.3")
    assert (left.faults, right.faults) == (Faults(delay_s=0.1), Faults())
    assert (left.clock.drift_ppm, right.clock.drift_ppm) == (0.0, 30.0)
    heard: list[bool] = []
    right.line("Line1").listen(lambda level, _: heard.append(level))
    left.line("Line2").drive(True)
    assert [True] == heard, "each output is wired to the other's input"
