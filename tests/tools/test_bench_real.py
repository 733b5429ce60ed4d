"""The bench of real pictures, on a folder with one of its sets."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.drawings import BRACKET, draw

TOOL = Path(__file__).resolve().parents[2] / "tools" / "bench_real.py"


@pytest.mark.long
def test_sets_that_are_there_are_measured(tmp_path: Path) -> None:
    """The three parts of a picture are found, and a missing set is named."""
    pictures = tmp_path / "fpm"
    pictures.mkdir()
    image = np.full((320, 700), 70, np.uint8)
    for k, angle in enumerate((0.4, -1.9, 2.8)):
        image = draw(BRACKET, (110 + 220 * k, 150, angle, 1, 1), (700, 320), 1.0, image)
    cv2.imwrite(str(pictures / "Src8.bmp"), image)
    cv2.imwrite(str(pictures / "Dst8.bmp"), draw(BRACKET, (75, 55, 0, 1, 1), (150, 110), 1.0))

    arguments = [tmp_path, "--overlays", tmp_path / "seen", "--json", tmp_path / "figures.json"]
    command = [sys.executable, TOOL, *arguments]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)

    (row,) = json.loads((tmp_path / "figures.json").read_text())["sets"]
    assert (row["name"], row["found"], row["parts"]) == ("e-clips", 3, 3)
    assert row["score"][0] > 0.9
    assert "lamps: fpm/Dst3.bmp" in ran.stderr
    assert "clock" in ran.stderr
    seen = cv2.imread(str(tmp_path / "seen" / "e-clips.png"))
    assert seen is not None
    blue, green, red = np.moveaxis(seen.astype(np.int64), 2, 0)
    assert np.count_nonzero((green > blue + 80) & (green > red + 80)) > 500
