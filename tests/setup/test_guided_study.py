"""A study of a size over the page: one measurement after another, with the report of `edged study`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.cells import flange
from helpers.partcell import PartCell, turned

from edged.files.jobs import save_job
from edged.files.statefolder import page_folder
from edged.pipeline import prepare
from edged.setup.acceptance.studies import gauge_study
from edged.vision.teaching.pair import teach

PARTS = {"parts": 5, "people": 2, "trials": 2}


@pytest.fixture
def cell(tmp_path: Path) -> PartCell:
    """A cell with a job of the flange, and the flange before its cameras."""
    made, part = PartCell(tmp_path), flange()
    job = teach(part.left, part.right, prepare(part.rig).rectification, part.region, "flange")
    save_job(tmp_path / "jobs" / "flange", job)
    return made


def plan(**other: Any) -> dict[str, Any]:
    """A study of the flange's bore: five parts, two people, two trials."""
    return {"job": "flange", "size": "c0", "low_mm": 27.95, "high_mm": 28.05, **PARTS, **other}


async def asked(cell: PartCell, path: str, **body: Any) -> tuple[int, Any]:
    """The answer to a request to the study."""
    return await cell.ask("POST", f"/acceptance/study{path}", body)


@pytest.mark.long
def test_a_study_goes_on_where_it_was_and_ends_in_the_commands_report(cell: PartCell) -> None:
    """The study names who measures which part, ignores repeated or failed measurements, outlives the
    daemon, and gives the figures of `edged study`; the audit names who took one back."""

    async def begun(cell: PartCell) -> None:
        assert (await cell.ask("GET", "/acceptance/study"))[1]["plan"] is None
        token = await cell.take()
        assert 409 == (await asked(cell, "/measure", **token, done=0))[0]  # there is none yet
        for wrong, status in (
            ({"size": "c9"}, 422),
            ({"job": "nothing"}, 422),
            ({"low_mm": 28.05}, 400),
            ({"parts": 4}, 400),
            ({"parts": 100, "people": 100}, 400),
            ({"reference_mm": 28.0}, 400),
            ({"trials": "2"}, 400),
            ({"colour": 1}, 400),
        ):
            assert status == (await asked(cell, "", **token, plan=plan(**wrong)))[0], wrong
        status, study = await asked(cell, "", **token, plan=plan())
        assert (200, {"part": 1, "person": 1, "trial": 1}) == (status, study["next"])
        assert 409 == (await asked(cell, "", **token, plan=plan()))[0]
        for done in range(6):
            assert 200 == (await asked(cell, "/measure", **token, done=done))[0]
        assert 409 == (await asked(cell, "/measure", **token, done=5))[0]  # pressed twice
        seen, cell.world.shown = cell.world.shown, (np.full_like(flange().left, 90),) * 2
        status, problem = await asked(cell, "/measure", **token, done=6)
        assert (422, "input_no_good_part") == (status, problem["code"])
        cell.world.shown = seen
        status, study = await asked(cell, "/back", **token, done=6)
        assert (200, 5, {"part": 1, "person": 2, "trial": 1}) == (
            status,
            len(study["values_mm"]),
            study["next"],
        )

    async def ended(cell: PartCell) -> None:
        _, study = await cell.ask("GET", "/acceptance/study")
        assert (5, 20) == (len(study["values_mm"]), study["needed"])
        assert 404 == (await cell.ask("GET", "/acceptance/study/report"))[0]
        token = await cell.take()
        for done in range(5, 20):
            cell.world.shown = turned(10.0 * (done % 5))
            status, study = await asked(cell, "/measure", **token, done=done)
            assert 200 == status, study
        assert 409 == (await asked(cell, "/measure", **token, done=20))[0]
        values = np.array(study["values_mm"]).reshape(2, 2, 5)  # trials, people, parts
        expected = gauge_study(values.transpose(2, 1, 0), 0.1)
        assert study["figures"]["%GRR of the tolerance"].startswith(f"{expected.of_tolerance:.1f} ")
        assert (None, expected.good) == (study["next"], study["good"])
        async with cell.session.get("/api/v1/acceptance/study/report") as answer:
            page = await answer.text()
        assert "part 3, person 2" in page
        assert f"{values[0, 1, 2]:.4f} {values[1, 1, 2]:.4f}" in page
        _, audit = await cell.ask("GET", "/audit")
        done = [one["object"] for one in audit["records"] if one["outcome"] == "ok"]
        deeds = [deed for deed in done if deed.startswith("acceptance/study")]
        assert ["acceptance/study/flange c0", "acceptance/study/back"] == sorted(deeds, reverse=True)
        file = page_folder(cell.config) / "study.json"
        kept = json.loads(file.read_text())
        file.write_text(json.dumps(kept | {"digest": "another", "values": kept["values"][:9]}))
        _, study = await cell.ask("GET", "/acceptance/study")
        assert not study["is_current"]
        status, problem = await asked(cell, "/measure", **token, done=9)
        assert (409, True) == (status, "changed since the study began" in problem["detail"])
        status, study = await asked(cell, "/end", **token)
        assert (200, None) == (status, study["plan"])

    cell.run(begun)
    cell.run(ended)
