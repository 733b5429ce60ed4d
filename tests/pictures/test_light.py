"""Clipped, dark and noisy pictures with advice, and the camera before which a hand is waved."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edged.domain.arrays import SIDES, FloatArray, Image, Side
from edged.pictures.change import changed_most, changed_share
from edged.pictures.light import Advice, light_of, noise_of
from edged.sim.cell import VirtualCell, demo_part, demo_rig
from edged.sim.exposure import ExposureRequest
from edged.sim.render.scene import Sensor
from edged.sim.stage import stage_board

S = 1_000_000_000


@pytest.fixture(scope="module")
def cell() -> VirtualCell:
    """The demo's cell with its board in the middle."""
    cell = VirtualCell(demo_rig(), demo_part(), board=stage_board())
    cell.show("board", _square(-12, -14, 200))
    return cell


def _square(x: float, y: float, z: float) -> FloatArray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def picture(
    cell: VirtualCell, at_s: float, side: str = "left", exposure_us: float = 2000.0, gain_db: float = 0.0
) -> Image:
    """The picture of a camera."""
    at_ns = round(at_s * S)
    return cell.exposure(side)(
        ExposureRequest(round(at_s * 10), at_ns, at_ns, exposure_us, gain_db, 1280, 960)
    )


@pytest.mark.parametrize("grey", [20.0, 60.0, 180.0])
@pytest.mark.parametrize("gain_db", [0.0, 12.0])
def test_noise_is_that_of_the_sensor(grey: float, gain_db: float) -> None:
    """The noise is the shot and read noise of the sensor at that grey value."""
    sensor = Sensor()
    gain = 10 ** (gain_db / 20)
    electrons = grey / 255 * sensor.full_well_e / gain
    expected = math.sqrt(electrons + sensor.read_noise_e**2) * gain * 255 / sensor.full_well_e
    rng = np.random.default_rng(2)
    image = np.tile(np.linspace(grey - 3, grey + 3, 640), (480, 1)) + rng.normal(0, expected, (480, 640))
    image[100:200, 100:300] = 255 * (np.add.outer(np.arange(100), np.arange(200)) // 9 % 2)
    noise = noise_of(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    assert noise == pytest.approx(math.hypot(expected, 12**-0.5), rel=0.06)


@pytest.mark.long
def test_exposure_is_advised_until_it_is_good(cell: VirtualCell) -> None:
    """Following the advised factor, from far too bright or too dark, ends at a good picture within five
    steps."""
    for start_us in (60.0, 12_000.0):
        exposure_us, seen = start_us, []
        for look in range(6):
            light = light_of(picture(cell, 1 + look, exposure_us=exposure_us))
            advice, factor = light.advice()
            seen.append(advice)
            exposure_us *= factor
        assert Advice.GOOD is seen[-1]
        assert (Advice.MORE_LIGHT if start_us < 1000 else Advice.LESS_LIGHT) is seen[0]


@pytest.mark.slow
def test_gain_that_is_only_noise_is_told(cell: VirtualCell) -> None:
    """Of two equally bright pictures the one by gain is noisier, and the advice is light."""
    by_light, by_gain = (
        light_of(picture(cell, 10, exposure_us=us, gain_db=db)) for us, db in ((1800.0, 0.0), (180.0, 20.0))
    )
    assert by_gain.bright_grey == pytest.approx(by_light.bright_grey, rel=0.15)
    assert by_gain.noise_grey > 2.5 * by_light.noise_grey
    assert (Advice.GOOD, 1.0) == by_light.advice(0.0)
    assert (Advice.LIGHT_FOR_GAIN, pytest.approx(10.0)) == by_gain.advice(20.0)


def test_shares_are_counted() -> None:
    """The shares of clipped and dark pixels are counted."""
    image = np.full((100, 100), 90, np.uint8)
    image[:10] = 255
    image[10:40] = 5
    light = light_of(image)
    assert (0.1, 0.3) == (light.clipped_share, light.dark_share)
    assert Advice.LESS_LIGHT is light.advice()[0]


# --- a hand is waved ----------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("waved", SIDES)
def test_the_camera_with_the_hand_is_found(cell: VirtualCell, waved: Side) -> None:
    """The camera with the waved hand is found, also with flicker, little light, and a moving board in both
    pictures."""
    first_s = 20 if waved == "left" else 25
    for at_s, exposures_us in zip(range(first_s, 30), ((2000, 2400), (300, 300), (2000, 1700)), strict=False):
        cell.show("board", _square(-12, -14, 200))
        before = {side: picture(cell, at_s, side, exposures_us[0]) for side in SIDES}
        cell.show("board", _square(-12.1, -14, 200))
        cell.wave(waved)
        shares = {
            side: changed_share(before[side], picture(cell, at_s + 0.5, side, exposures_us[1]))
            for side in SIDES
        }
        cell.wave(None)
        assert waved == changed_most(shares)


@pytest.mark.slow
def test_nobody_waves(cell: VirtualCell) -> None:
    """Noise, flicker and a board that is taken away in both pictures count as no wave."""
    cell.show("board", _square(-12, -14, 200))
    before = {side: picture(cell, 30, side) for side in SIDES}
    again = {side: changed_share(before[side], picture(cell, 31, side, 2300.0)) for side in SIDES}
    cell.show("nothing")
    gone = {side: changed_share(before[side], picture(cell, 32, side)) for side in SIDES}
    assert max(again.values()) < 0.04
    assert min(gone.values()) > 0.2
    assert [None, None, None] == [changed_most(shares) for shares in (again, gone, {})]
