"""The inspection of a taught shape predicts what the search does."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers import cells, drawings
from helpers.htmlpages import HtmlPage
from rich.console import Console

from edged.commands.teach import PairSource, teach
from edged.files.rig import save_rig
from edged.vision.geometry.rigid import wrapped
from edged.vision.shape.inspection import ModelInspection, inspect_model
from edged.vision.shape.learning import create_model
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.params import LEARNING
from edged.vision.shape.search import SearchParams, find_shapes

RIGID = SearchParams(sub_pixel="similarity", scale_min=0.95, scale_max=1.05)


def learnt(outlines: tuple[tuple[np.ndarray, float], ...]) -> tuple[ShapeModel, ModelInspection]:
    """Model and inspection of a drawn part."""
    image = drawings.draw(outlines, (100.0, 90.0, 0.0, 1.0, 1.0), (200, 180), noise=0.5)
    model = create_model(image, np.full(image.shape, 255, np.uint8), np.array([100.0, 90.0]))
    return model, inspect_model(model, RIGID)


def test_symmetries_are_said_in_words() -> None:
    """A round, a symmetric and a nearly symmetric part have their own warnings."""
    ring = ((drawings.disc(0, 0, 62), 200.0), (drawings.disc(0, 0, 22), 60.0))
    _, round_one = learnt(ring)
    _, six = learnt(drawings.flange(False))
    _, five = learnt(drawings.flange(True))
    _, bracket = learnt(drawings.BRACKET)

    assert round_one.round and "no rotation" in round_one.warnings[0]
    assert np.isinf(round_one.sigma_angle_rad)
    assert six.symmetric and "looks the same after a turn of" in six.warnings[0]
    assert not five.symmetric and "AMBIGUOUS_ROTATION" in five.warnings[0]
    assert not any("turn" in warning for warning in bracket.warnings)


@pytest.mark.long
def test_the_expected_precision_is_reached() -> None:
    """The scatter of the search at the stated noise is near the stated bound."""
    model, inspection = learnt(drawings.BRACKET)
    errors = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        pose = (150 + rng.uniform(), 140 + rng.uniform(), rng.uniform(-3, 3), 1.0, 1.0)
        clean = drawings.draw(drawings.BRACKET, pose, (320, 280), noise=0.0).astype(np.float64)
        noisy = np.clip(np.rint(clean + rng.normal(0, LEARNING.noise, clean.shape)), 0, 255).astype(np.uint8)
        (match,) = find_shapes(noisy, model, RIGID)
        turn = wrapped(match.angle_rad - pose[2])
        errors.append([match.x_px - pose[0], match.y_px - pose[1], turn, match.scale_x - 1])
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    expected = [
        inspection.sigma_x_px,
        inspection.sigma_y_px,
        inspection.sigma_angle_rad,
        inspection.sigma_scale,
    ]
    place = np.hypot(*rms[:2]) / np.hypot(*expected[:2])  # the part is turned: x and y mix
    assert 0.7 < place < 2.0
    assert 0.6 < rms[2] / expected[2] < 2.0
    assert 0.6 < rms[3] / expected[3] < 2.5


def test_weak_contrast_is_said() -> None:
    """A part with weak contrast has a small reserve and a warning that asks for more light."""
    faint = tuple((points, 70 + 0.1 * (grey - 70)) for points, grey in drawings.BRACKET)
    _, inspection = learnt(faint)
    assert inspection.reserve < 3
    assert any("more light" in warning for warning in inspection.warnings)


@pytest.mark.slow
def test_teach_writes_the_page_and_the_facts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Teaching writes one self-contained page, and the same facts as JSON."""
    flat = cells.flange()
    save_rig(tmp_path / "rig.json", flat.rig)
    for side, image in (("left", flat.left), ("right", flat.right)):
        cv2.imwrite(str(tmp_path / f"{side}.png"), image)
    region = flat.region
    roi = f"{region.x},{region.y},{region.width},{region.height}"
    source = PairSource(tmp_path / "left.png", tmp_path / "right.png", roi)
    teach(
        tmp_path / "rig.json", source, "flange", tmp_path / "job", Console(stderr=True),
        report=tmp_path / "flange.html", as_json=True,
    )  # fmt: skip
    page, facts = (tmp_path / "flange.html").read_text(), json.loads(capsys.readouterr().out)

    assert [] == HtmlPage(page).open
    assert 1 + len(facts["levels"]) == page.count("data:image/png;base64,")  # the region, and each level
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "")  # a name, not an address
    drawing = page[page.index("<svg") : page.index("</svg>")]
    assert all(f">{circle['name']}</text>" in drawing for circle in facts["circles"])
    assert facts["circles"][0]["radius_mm"] == pytest.approx(14.0, abs=0.01)
    assert facts["expected_sigma"]["x_px"] < 0.02
