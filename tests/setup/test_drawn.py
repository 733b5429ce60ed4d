"""A job from a DXF drawing in a draft, over HTTP and a running daemon, equals the command's job."""

from __future__ import annotations

import io
from base64 import b64encode
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.cells import flange
from helpers.flangedrawing import flange_drawing
from helpers.partcell import PartCell
from rich.console import Console

from edged.commands.teach import DrawingSource, TeachOptions, teach
from edged.files.jobs import load_job

DEPTH_MM = 205.0


def sent(path: Path, **how: Any) -> dict[str, Any]:
    """The drawing as the page sends it."""
    return {"name": path.name, "data": b64encode(path.read_bytes()).decode(), **how}


@pytest.mark.long
async def test_the_job_is_that_of_the_command_line(tmp_path: Path) -> None:
    """The job equals the command's byte by byte, also with the depth from the pair; its features lie
    on the part in the pictures, and a tapped gripping point is kept.
    """
    path, made = flange_drawing(tmp_path), list[bytes]()

    (tmp_path / "cell").mkdir()
    async with PartCell(tmp_path / "cell").running() as cell:
        token = await cell.take()
        draft = await cell.begun(**token)
        by_pair = await cell.change("POST", draft, "/dxf", sent(path))
        assert None is by_pair["trouble"], by_pair["trouble"]
        assert abs(by_pair["drawing"]["depth_mm"] - DEPTH_MM) < 0.5
        drawn = await cell.change("POST", by_pair, "/dxf", sent(path, depth_mm=DEPTH_MM))
        assert {"name": "flange.dxf", "depth_mm": DEPTH_MM, "outlines": 7} == drawn["drawing"]

        truth = flange()
        x, y = truth.rig.left.project(truth.rig_from_part[None, :3, 3])[0]
        radius_px = 14.0 * truth.rig.left.fx / truth.rig_from_part[2, 3]
        largest = max(drawn["features"], key=lambda one: one["size"].get("diameter_mm", 0.0))
        apart = np.hypot(*(np.array(largest["outline"]["left"]) - (x, y)).T) - radius_px
        assert np.abs(apart).max() < 0.02 * radius_px
        outer = np.concatenate([np.array(one) for one in drawn["outlines"]["left"]])
        assert np.hypot(*(outer - (x, y)).T).max() < 1.02 * radius_px
        assert max(drawn["predicted"]["sigma_um"].values()) < 50.0

        gripped = await cell.change("PUT", drawn, "", {"gripping": {"at": [x, y]}})
        assert np.hypot(*(np.array(gripped["gripping"]["left"]) - (x, y))) < 0.5
        back = await cell.change("POST", gripped, "/undo", {})
        assert None is back["gripping"]
        status, _ = await cell.ask("POST", f"/teachings/{draft['id']}/activate", {"note": "drawn", **token})
        assert 200 == status
        (folder,) = (cell.config.parent / "jobs").iterdir()
        made.extend((folder / name).read_bytes() for name in ("job.toml", "shape.npz"))

        again = await cell.begun(job=folder.name)
        assert drawn["drawing"] == again["drawing"]
        tapped = await cell.change("POST", again, "/tap", {"x": x, "y": y})
        assert None is tapped["drawing"]
    output = tmp_path / "part1"
    source = DrawingSource(dxf=path, contour=None, depth_mm=DEPTH_MM, layers=(), unit=None)
    assert 0 == teach(cell.rig, source, "part1", output, Console(file=io.StringIO()), TeachOptions(1))
    assert load_job(output).name == "part1"
    assert made == [(output / name).read_bytes() for name in ("job.toml", "shape.npz")]


@pytest.mark.slow
async def test_what_is_no_drawing_of_the_part_is_said(tmp_path: Path) -> None:
    """A wrong drawing is refused with its place, one that is too large is refused, one of another size is
    not found in the pair, and the draft stays or goes back by one step.
    """
    (tmp_path / "cell").mkdir()
    async with PartCell(tmp_path / "cell").running() as cell:
        draft = await cell.begun(**await cell.take())

        async def refused(path: Path, **how: Any) -> tuple[str, dict[str, Any]]:
            status, problem = await cell.ask("POST", f"/teachings/{draft['id']}/dxf", sent(path, **how))
            assert 422 == status, problem
            assert str(tmp_path) not in problem["detail"]
            return problem["code"], problem.get("params") or {}

        text = tmp_path / "notes.dxf"
        text.write_text("no drawing")
        assert "teach_drawing_no_dxf" == (await refused(text))[0]
        assert "teach_drawing_unit" == (await refused(flange_drawing(tmp_path, units=0)))[0]
        code, place = await refused(flange_drawing(tmp_path, is_open=True))
        assert "teach_drawing_open" == code
        assert ({"30.000", "40.000"} & {place["x"]}, place["y"]) == ({place["x"]}, "5.000")
        code, layers = await refused(flange_drawing(tmp_path), layers=["cut"])
        assert ("teach_drawing_layer", "'0'") == (code, layers["there"].split(", ")[0])
        assert "teach_drawing_large" == (await refused(flange_drawing(tmp_path, scale=1e12)))[0]
        assert draft["features"] == (await cell.learnt(draft["id"]))["features"]

        other = await cell.change("POST", draft, "/dxf", sent(flange_drawing(tmp_path, scale=0.4)))
        assert "teach_not_as_drawn" == other["trouble"]["code"]
        assert [] == other["features"]
        back = await cell.change("POST", other, "/undo", {})
        assert draft["features"] == back["features"]
