"""`edged doctor` with reference marks: what a test picture shows of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.markedcell import marked_cell, pair_at, prepared, teach

from edged.config.reading import load
from edged.doctor.findings import CheckResult
from edged.doctor.pictures import look_at_marks
from edged.domain.frames import FramePair
from edged.files.rig import load_rig
from edged.sim.weather import Knock


@pytest.mark.long
def test_the_doctor_says_what_the_marks_say(tmp_path: Path) -> None:
    """There is no finding without marks, and one each for marks that are OK, moved or covered, with
    advice."""
    files = prepared(tmp_path)
    rig = load_rig(files.rig)
    cell = marked_cell(Knock(50.0, "left", (1.0, 0.0, 0.0)))
    still, knocked = pair_at(cell, 0), pair_at(cell, 60)
    assert list(look_at_marks(load(files.config), rig, still)) == []
    teach(files)
    config = load(files.config)
    (well,) = look_at_marks(config, rig, still)
    assert well.verdict is CheckResult.OK
    assert well.finding.startswith("8 of 8 are seen; the cameras moved by")
    (moved,) = look_at_marks(config, rig, knocked)
    assert moved.verdict is CheckResult.WARN
    assert "KNOCKED: the left camera was moved" in moved.finding
    assert moved.consequence == "results are refused"
    blank = [replace(frame, image=np.full_like(frame.image, 90)) for frame in (still.left, still.right)]
    (covered,) = look_at_marks(config, rig, FramePair(blank[0], blank[1]))
    assert covered.finding == "COASTING: 0 of 8 marks are seen"
    assert "edged marks status" in covered.remedy
    assert list(look_at_marks(config, None, still)) == []
