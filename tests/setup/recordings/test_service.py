"""Recorded cycles as shown on the page: listed, feature by feature, and what would have helped."""

from __future__ import annotations

import json
import os
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
from helpers.boardcell import BoardCell
from helpers.cellinuse import StillCell
from helpers.recordedcell import exposures, record
from helpers.smallcell import SmallCell

from edged.domain.frames import FramePair
from edged.errors import FileFormatError, UserError
from edged.files import recording
from edged.payload import Json
from edged.setup.cellfiles import CellFiles, read_cell
from edged.setup.jobs.worker import Worker
from edged.setup.pairs import silent
from edged.setup.recordings import work as cyclework
from edged.setup.recordings.recorded import CycleFilter, Damaged, Records
from edged.setup.recordings.recordedparts import NOT_FOUND, OUTSIDE, PartSight, parts_of, taught_part
from edged.setup.recordings.service import FUNCTIONS, Cycles
from edged.setup.recordings.setups import rig_and_job, setup_of
from edged.setup.recordings.whatif import Change, LimitChange, WhatIf, changed_job
from edged.sim.cell import VirtualCell
from edged.vision.geometry.rigid import apply


class Recorded(NamedTuple):
    """A cell with recordings: two good ones, then those named below."""

    folder: Path
    files: CellFiles
    virtual: VirtualCell
    pairs: list[FramePair]


GOOD, VAGUE, COVERED, EMPTY, UNPLUGGED = 1, 2, 3, 4, 5


def changed(pair: FramePair, change: Callable[[Any], Any]) -> FramePair:
    """The exposure with changed pixels."""
    return FramePair(
        *(replace(one, image=change(one.image).astype(np.uint8)) for one in (pair.left, pair.right))
    )


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Recordings by the real pipeline."""
    folder = tmp_path_factory.mktemp("recorded")
    cell = SmallCell(folder / "cell", source="virtual-inprocess")
    job = cell.config.parent / "jobs" / "flange" / "job.toml"
    text = job.read_text()
    for before, after in (
        ("max_sigma_mm = 0.2", "max_sigma_mm = 0.05"),
        ("min_score = 0.6", "min_score = 0.8"),
    ):
        assert before in text
        text = text.replace(before, after)
    job.write_text(text)
    files = read_cell(cell.config)
    pairs = exposures(cell.virtual, 3)
    rng = np.random.default_rng(1)

    def noisy(image: Any) -> Any:
        return np.clip(image * 0.15 + rng.normal(0, 3, image.shape), 0, 255)

    def covered(image: Any) -> Any:
        shown = image.copy()
        shown[:88] = rng.integers(20, 30, shown[:88].shape)
        return shown

    kept = [
        pairs[0],
        pairs[1],
        changed(pairs[0], noisy),
        changed(pairs[2], covered),
        changed(pairs[0], lambda image: rng.integers(20, 30, image.shape)),
        None,
    ]
    record(folder / "recordings", files, kept)
    return Recorded(folder / "recordings", files, cell.virtual, pairs)


def seen(recorded: Recorded, number: int) -> tuple[Json, list[PartSight]]:
    """Snapshot and parts of a recording."""
    entry = Records(recorded.folder).entry(number)
    snapshot, _ = recording.load_snapshot(entry.path)
    rig, job = rig_and_job(entry.path, snapshot)
    return snapshot, parts_of(snapshot, rig.rig, job, "here")


def tried(recorded: Recorded, number: int, change: Change | None) -> WhatIf:
    """What-if result, as the worker makes it."""
    return cyclework.what_if(Records(recorded.folder).entry(number).path, change, silent)


@pytest.mark.slow
def test_the_list_says_what_became_of_each_cycle(recorded: Recorded) -> None:
    """The list is newest first, with reasons, filtered by status, reason, job and number, in pages."""
    records = Records(recorded.folder)
    page = records.page(CycleFilter())
    assert [5, 4, 3, 2, 1, 0] == [line.number for line in page.cycles]
    told = [(line.status, line.reasons) for line in page.cycles]
    assert ("CAPTURE_FAULT", ("CAPTURE",)) == told[0]
    assert ("NO_TARGET", ("NOT_FOUND",)) == told[1] == told[2]
    assert ("LOW_QUALITY", ("SIGMA_LIMIT",)) == told[3]
    assert ("OK", ()) == told[4] == told[5]
    assert {"OK": 2, "LOW_QUALITY": 1, "NO_TARGET": 2, "CAPTURE_FAULT": 1} == page.counts

    def numbers(**wanted: Any) -> list[int]:
        return [line.number for line in records.page(CycleFilter(**wanted)).cycles]

    assert [1, 0] == numbers(status="OK")
    assert [2] == numbers(reason="SIGMA_LIMIT")
    assert [] == numbers(job="another")
    assert [3, 2] == numbers(before=4, most=2)
    assert records.page(CycleFilter(before=4, most=2)).has_more
    assert not records.page(CycleFilter(before=2, most=2)).has_more


def test_damaged_recordings_are_told_and_take_nothing_with_them(recorded: Recorded, tmp_path: Path) -> None:
    """Files that are no archive, have no or an invalid document, unpack to too much, or are pipes are
    named as damaged, and the others are listed.
    """
    folder = tmp_path / "recordings"
    shutil.copytree(recorded.folder, folder)
    whole = recording.entries(folder)[GOOD].path

    def name(number: int) -> Path:
        return whole.with_name(f"{number:09d}" + whole.name[9:])

    name(10).write_bytes(b"no archive")
    with zipfile.ZipFile(name(11), "w") as archive:
        archive.writestr("left.png", b"")
    with zipfile.ZipFile(name(12), "w") as archive:
        archive.writestr(
            "recording.json", json.dumps({"format": "edged-recording", "version": 1, "snapshot": 7})
        )
    with zipfile.ZipFile(name(13), "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("recording.json", b" " * (recording.MAX_DOCUMENT_BYTES + 1))
    with zipfile.ZipFile(name(14), "w") as archive:
        archive.writestr("recording.json", b"[" * 100_000)
    os.mkfifo(name(15))
    (folder / "cycles" / "notes.zip").write_text("not ours")

    page = Records(folder).page(CycleFilter())
    assert [5, 4, 3, 2, 1, 0] == [line.number for line in page.cycles]
    assert [f"{number:09d}" for number in (15, 14, 13, 12, 11, 10)] == [one.file[:9] for one in page.damaged]
    assert all(one.why for one in page.damaged)


def test_outlines_lie_where_the_part_is(recorded: Recorded) -> None:
    """Outlines are within a tenth of a pixel of the true edge in both pictures, with taught beside
    measured."""
    _, (part,) = seen(recorded, GOOD)
    truth = recorded.virtual.truth(10**9)
    assert truth is not None
    phase = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    ring = 14.0 * np.column_stack([np.cos(phase), np.sin(phase), 0 * phase])
    rig = recorded.virtual.rig
    space = apply(truth.rig_from_part, ring)
    (feature,) = part.features
    for told, camera, points in (
        (feature.outline.left, rig.left, space),
        (feature.outline.right, rig.right, apply(rig.right_from_left, space)),
    ):
        apart = np.linalg.norm(np.array(told)[:, None] - camera.project(points)[None], axis=2).min(axis=1)
        assert len(told) > 60
        assert apart.max() < 0.6  # points of the true ring are up to half a pixel apart
        assert abs(apart.mean()) < 0.3
    assert ("c0", "circle", None, True) == (feature.key, feature.kind, feature.why, part.good)
    assert 28.0 == pytest.approx(feature.taught["diameter_mm"], abs=0.02)
    assert feature.now is not None
    assert feature.off_um == pytest.approx(
        1e3 * (feature.now["diameter_mm"] - feature.taught["diameter_mm"]), abs=0.02
    )
    taught = taught_part(rig, recorded.files.jobs[0])
    assert [one.key for one in part.features] == [one.key for one in taught.features]


def test_a_miss_shows_where_it_nearly_was(recorded: Recorded) -> None:
    """For a miss the outline of the best candidate is within a few pixels of the part."""
    snapshot, (part,) = seen(recorded, COVERED)
    assert snapshot["nearest"]["needed_score"] == part.needed_score == 0.8
    assert part.score is not None
    assert part.score < 0.8
    (feature,) = part.features
    assert NOT_FOUND == feature.why
    truth = recorded.virtual.truth(2 * 10**9)
    assert truth is not None
    rig = recorded.virtual.rig
    centre = truth.rig_from_part[None, :3, 3]
    for told, camera, point in (
        (feature.outline.left, rig.left, centre),
        (feature.outline.right, rig.right, apply(rig.right_from_left, centre)),
    ):
        off = np.array(told).mean(axis=0) - camera.project(point)[0]
        assert np.abs(off).max() < 6.0


def test_a_feature_beyond_the_picture_says_so(recorded: Recorded) -> None:
    """A feature outside of the picture is marked so, and an invalid snapshot raises FileFormatError."""
    snapshot, _ = seen(recorded, GOOD)
    rig, job = recorded.virtual.rig, recorded.files.jobs[0]
    target = {**snapshot["targets"][0], "circles": []}
    moved = [500.0, *target["position_mm"][1:]]
    (part,) = parts_of({"targets": [{**target, "position_mm": moved}]}, rig, job, "here")
    assert OUTSIDE == part.features[0].why
    for place in ([None, None, None], [1e300, -1e300, 1e-300], [0, 0, 0]):
        (part,) = parts_of({"targets": [{**target, "position_mm": place}]}, rig, job, "here")
        assert part.features[0].why in (OUTSIDE, "unseen")
    for wrong in (
        {"targets": 7},
        {"targets": [{**target, "match": {}}]},
        {"nearest": [1]},
        {"rejected": [7]},
    ):
        with pytest.raises(FileFormatError, match="here: snapshot"):
            parts_of(wrong, rig, job, "here")


def test_what_would_have_helped_is_tried_and_costs_are_said(recorded: Recorded) -> None:
    """Helpful changes are listed with their cost, each making the cycle OK by itself; for a good cycle or an
    empty table there are none.
    """
    vague = tried(recorded, VAGUE, None)
    assert ("LOW_QUALITY", ["SIGMA_LIMIT"], None) == (vague.before.status, vague.before.reasons, vague.after)
    assert vague.helped is not None
    (limit,) = [one for one in vague.helped if one.code == "max_sigma_mm"]
    assert limit.cost == "loosens"
    assert vague.before.sigma_um is not None
    worst = max(one for one in vague.before.sigma_um if one is not None)
    assert limit.after is not None
    assert worst < 1e3 * limit.after[0]
    assert limit.change.limits is not None
    tighter = limit.change.limits.model_copy(update={"max_sigma_mm": limit.after[0] / 1.2})
    still = tried(recorded, VAGUE, limit.change.model_copy(update={"limits": tighter})).after
    assert still is not None
    assert "LOW_QUALITY" == still.status
    for remedy in vague.helped:
        after = tried(recorded, VAGUE, remedy.change).after
        assert after is not None
        assert "OK" == after.status
        assert remedy.sigma_um == after.sigma_um

    covered = tried(recorded, COVERED, None)
    assert covered.helped is not None
    assert "min_score" in [one.code for one in covered.helped]
    assert [] == tried(recorded, GOOD, None).helped == tried(recorded, EMPTY, None).helped
    with pytest.raises(UserError, match="no pictures"):
        tried(recorded, UNPLUGGED, None)


def test_without_a_change_the_verdict_is_that_of_then(recorded: Recorded) -> None:
    """Without a change the result is bit-identical, a stricter limit changes it, and an empty job is
    refused."""
    snapshot, parts = seen(recorded, GOOD)
    same = tried(recorded, GOOD, Change(light=1.0))
    assert same.after is not None
    assert snapshot["status"] == same.before.status == same.after.status
    assert parts == same.before.parts == same.after.parts

    strict = tried(recorded, GOOD, Change(limits=LimitChange(max_sigma_mm=0.0001)))
    assert strict.after is not None
    assert ("LOW_QUALITY", ["SIGMA_LIMIT"]) == (strict.after.status, strict.after.reasons)
    job = recorded.files.jobs[0]
    with pytest.raises(UserError, match="is the reference"):
        changed_job(job, Change(features={"c0": False}))
    with pytest.raises(UserError, match="no feature c9"):
        changed_job(job, Change(features={"c9": False}))


async def test_a_rig_or_job_that_is_not_kept_leaves_the_pictures(recorded: Recorded, tmp_path: Path) -> None:
    """If rig or job are missing, the document says so and pictures remain; other files cannot be reached."""
    folder = tmp_path / "recordings"
    shutil.copytree(recorded.folder, folder)
    shutil.rmtree(folder / "setups")
    config = tmp_path / "cell.toml"
    config.write_text(
        '[cell]\nname = "cell1"\nrig = "rig.json"\njobs = "jobs"\n'
        '[cameras]\nsource = "virtual-inprocess"\n[recorder]\nfolder = "recordings"\n'
    )
    worker = Worker(FUNCTIONS)
    cycles = Cycles(StillCell(config).in_use(worker))
    document = await cycles.document(GOOD)
    assert ("setup", None, True) == (document.trouble, document.now, document.has_pictures)
    assert (await cycles.picture(GOOD, "left"))[:2] == b"\xff\xd8"
    with pytest.raises(KeyError):
        await cycles.document(77)
    await cycles.close()
    await worker.close()
    with pytest.raises(FileFormatError, match="not there"):
        setup_of(folder / "cycles" / "a.zip", {"fingerprint": ".."})


@pytest.mark.long
async def test_over_http_a_failed_cycle_stands_beside_a_good_one(recorded: Recorded, tmp_path: Path) -> None:
    """List, document, JPEG pictures and what-if work over HTTP, oversized pictures are not unpacked, and
    wrong requests are refused with a reason.
    """
    folder = tmp_path / "cell" / "recordings"
    shutil.copytree(recorded.folder, folder)
    bomb = recording.entries(folder)[GOOD].path
    bomb = bomb.with_name("000000009" + bomb.name[9:])
    shutil.copy(recording.entries(folder)[GOOD].path, bomb)
    with zipfile.ZipFile(bomb) as archive:
        members = {one: archive.read(one) for one in archive.namelist()}
    members["left.png"] = (
        members["left.png"][:16] + 2 * (40_000).to_bytes(4, "big") + members["left.png"][24:]
    )
    with zipfile.ZipFile(bomb, "w") as archive:
        for one, data in members.items():
            archive.writestr(one, data)
    cell = BoardCell(tmp_path / "cell")
    cell.config.write_text(cell.config.read_text() + '[recorder]\nfolder = "recordings"\nmin_free_mib = 0\n')

    async with cell.running():
        _, listed = await cell.ask("GET", "/cycles?status=LOW_QUALITY&most=5")
        assert [VAGUE] == [one["number"] for one in listed["cycles"]]
        assert listed["recorder"]
        assert 400 == (await cell.ask("GET", "/cycles?status=BAD"))[0]
        assert 400 == (await cell.ask("GET", "/cycles?most=100000"))[0]
        for number in ("1_0", "%201", "5%20", "+5"):
            assert 400 == (await cell.ask("GET", f"/cycles?most={number}"))[0], number

        status, document = await cell.ask("GET", f"/cycles/{VAGUE}")
        assert 200 == status
        assert ("now", VAGUE) == (document["now"]["kind"], document["now"]["number"])
        assert ("good", 9, True) == (
            document["beside"]["kind"],
            document["beside"]["number"],
            document["beside"]["parts"][0]["good"],
        )
        assert document["taught"]["pictures"] is None
        for side in ("left", "right"):
            status, data = await cell.ask("GET", document["now"]["pictures"][side].removeprefix("/api/v1"))
            picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
            assert (document["now"]["height"], document["now"]["width"]) == picture.shape[:2]
        assert 404 == (await cell.ask("GET", "/cycles/9/left.jpg"))[0]
        assert 404 == (await cell.ask("GET", "/cycles/77"))[0]

        what_if = f"/cycles/{VAGUE}/what-if"
        _, told = await cell.ask("POST", what_if, {"limits": {"max_sigma_mm": 1}})
        assert ("LOW_QUALITY", "OK", None) == (
            told["before"]["status"],
            told["after"]["status"],
            told["helped"],
        )
        _, told = await cell.ask("POST", what_if, {})
        assert "max_sigma_mm" in [one["code"] for one in told["helped"]]
        for wrong in ({"limits": {"colour": 1}}, {"light": 1e9}, {"limits": {"depth_mm": [3, 2]}}):
            assert 400 == (await cell.ask("POST", what_if, wrong))[0], wrong
        assert 422 == (await cell.ask("POST", what_if, {"features": {"c0": False}}))[0]


def test_seven_hundred_cycles_are_read_once(
    recorded: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Listing again opens no known file, and deleted ones disappear."""
    folder = tmp_path / "recordings"
    shutil.copytree(recorded.folder, folder)
    records = Records(folder)
    assert 6 == len(records.page(CycleFilter()).cycles)
    opened: list[Path] = []

    def load(path: Path) -> Any:
        opened.append(path)
        raise FileFormatError("opened again")

    monkeypatch.setattr(recording, "load_snapshot", load)
    assert 6 == len(records.page(CycleFilter()).cycles)
    recording.entries(folder)[0].path.unlink()
    assert [5, 4, 3, 2, 1] == [line.number for line in records.page(CycleFilter()).cycles]
    assert [] == opened
    assert not any(isinstance(records.line(one), Damaged) for one in records.entries())
