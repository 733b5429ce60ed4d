"""Parts that others have designed are drawn where the truth says that they are."""

from __future__ import annotations

from pathlib import Path

import pytest
from bench_solid import asked, measured
from cadworld import kind_of, write_files

CAD = Path(__file__).parents[1] / "data" / "cad"


@pytest.mark.long
def test_a_file_becomes_a_set_that_its_file_finds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A part is found where it was drawn; what is no part of this size is left out, and said."""
    (tmp_path / "no.step").write_text("no")
    write_files(tmp_path / "set", [tmp_path / "no.step", CAD / "D3.step"], 1, 1)
    said = capsys.readouterr().out
    assert "left out: " in said
    assert "not a STEP file" in said
    assert "F01: D3.step, -z up" in said
    (row,) = measured(asked(tmp_path / "set", "--step"))
    assert ("F01", "good") == (row.design, row.verdict)


def test_what_a_triangle_is_follows_from_its_normal() -> None:
    """Level faces look up, chamfers lean, walls stand, and the rest is never seen."""
    assert ["face", "break", "wall", "under"] == [kind_of(z) for z in (-1.0, -0.7, 0.0, 0.7)]
