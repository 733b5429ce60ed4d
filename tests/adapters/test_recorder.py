"""Recordings: what is kept and what is left out, and replay with identical results."""

from __future__ import annotations

import asyncio
import io
import json
import threading
import time
import zipfile
from collections.abc import Iterable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.cells import pose, small_rig
from helpers.snapshots import make_snapshot
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from edged.adapters.recorder import Recorder
from edged.app.cell import load_cell
from edged.app.daemon import Daemon
from edged.commands.demo import DemoOptions, prepare_cell
from edged.commands.locate import LocateOutputs
from edged.commands.locate import locate as locate_command
from edged.commands.replay import replay
from edged.config.cell import RecorderSection
from edged.domain.events import Event, ExposureDone, Snapshot
from edged.domain.frames import Frame, FramePair
from edged.domain.measurement import Match, Nearest, NearMiss, Status
from edged.errors import FileFormatError
from edged.files import recording
from edged.setup.recordings.regression import compare
from edged.sim.cell import VirtualCell, demo_part
from edged.sim.showing import Thing
from edged.sim.world import VirtualWorld

FINGERPRINT = "0badcafe"
START_NS = 1_700_000_000_000_000_000
DAY_NS = 86_400 * 10**9


def make_pair(seed: int = 0, size: tuple[int, int] = (48, 64)) -> FramePair:
    """A pair of two small noise pictures."""
    rng = np.random.default_rng(seed)
    return FramePair(
        *(Frame(side, 7, rng.integers(0, 256, size, np.uint8), 5, START_NS) for side in ("left", "right"))
    )


def run_events(recorder: Recorder, events: Iterable[Event], *, pace: bool = True) -> None:
    """Run a recorder over events; pace : it gets time to write each."""

    async def live() -> None:
        await recorder.start()
        for event in events:
            recorder.announce(event)
            while pace and recorder._waiting:  # noqa: ASYNC110, SLF001  (there is no event for it)
                await asyncio.sleep(0.001)
        await recorder.close()

    asyncio.run(live())


def cycles(*statuses: Status, first: int = 1) -> list[Event]:
    """Exposure and result of one cycle for each status."""
    events: list[Event] = []
    for cycle, status in enumerate(statuses, first):
        events.append(ExposureDone(cycle, None, make_pair(cycle)))
        events.append(replace(make_snapshot(cycle, status), fingerprint=FINGERPRINT))
    return events


def recorder(folder: Path, clock: list[int] | None = None, **limits: float) -> Recorder:
    """A recorder with small limits whose setup is one file. clock : its time, from START_NS."""
    chosen = {"min_free_mib": 0, **limits}
    now = clock if clock is not None else [START_NS]
    files = {"rig.json": b"{}", "jobs/flange/job.toml": b""}
    return Recorder(
        RecorderSection(folder=folder, **chosen),
        lambda: (FINGERPRINT, files),
        lambda: now[0],
    )


def test_a_recording_is_lossless(tmp_path: Path) -> None:
    """Images, times and the published result read back equal."""
    pair, snapshot = make_pair(), replace(make_snapshot(3), exposed_count=42)
    pair = replace(pair, right=replace(pair.right, count=42))
    entry = recording.save(tmp_path, 12, datetime(2026, 1, 31, 23, 59, 59, 123456, UTC), snapshot, pair)

    taken = recording.load(entry.path)

    assert entry == recording.entries(tmp_path)[0]
    assert taken.pair is not None
    for before, after in ((pair.left, taken.pair.left), (pair.right, taken.pair.right)):
        assert np.array_equal(before.image, after.image)
        for name in ("camera", "frame_id", "device_ns", "exposed_ns", "count"):
            assert getattr(before, name) == getattr(after, name)
    assert (3, 42) == (taken.snapshot["cycle"], taken.snapshot["exposed_count"])
    assert taken.versions == recording.versions()


@pytest.mark.slow
@settings(max_examples=60)
@given(st.data())
def test_a_damaged_recording_is_named(data: st.DataObject) -> None:
    """Cut, changed or foreign bytes give a readable recording or a FileFormatError."""
    whole = recording.encode(make_snapshot(), make_pair())
    cut = data.draw(st.integers(0, len(whole)))
    damaged = bytearray(whole[:cut])
    for _ in range(data.draw(st.integers(0, 4))):
        if damaged:
            damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    try:
        recording.decode(bytes(damaged), "there")
    except FileFormatError as error:
        assert str(error).startswith("there")


@pytest.mark.parametrize(
    ("member", "content", "expected"),
    [
        ("recording.json", b"[]", 'expected "format"'),
        ("recording.json", b'{"format": "edged-recording", "version": 99}', "version 99"),
        ("left.png", b"no picture", "left.png: not an image"),
    ],
)
def test_a_wrong_member_is_named(member: str, content: bytes, expected: str) -> None:
    """A wrong member is refused with its name and what was expected."""
    whole = zipfile.ZipFile(io.BytesIO(recording.encode(make_snapshot(), make_pair())))
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in whole.namelist():
            archive.writestr(name, content if name == member else whole.read(name))

    with pytest.raises(FileFormatError, match=expected):
        recording.decode(buffer.getvalue(), "file")


@pytest.mark.slow
def test_the_rings_keep_bad_cycles_longer(tmp_path: Path) -> None:
    """Many good cycles do not remove an older bad one."""
    statuses = [Status.LOW_QUALITY] + [Status.OK] * 7
    run_events(recorder(tmp_path, keep_good=3, keep_bad=5), cycles(*statuses))

    assert [(entry.index, entry.status) for entry in recording.entries(tmp_path)] == [
        (0, "LOW_QUALITY"),
        (5, "OK"),
        (6, "OK"),
        (7, "OK"),
    ]


def test_numbers_go_on_after_a_restart_with_an_earlier_clock(tmp_path: Path) -> None:
    """After a restart with an earlier clock numbers go on, and the limits hold over both runs."""
    run_events(recorder(tmp_path, [START_NS], keep_good=3), cycles(Status.OK, Status.OK))
    run_events(recorder(tmp_path, [START_NS - DAY_NS], keep_good=3), cycles(Status.OK, Status.OK))

    assert [entry.index for entry in recording.entries(tmp_path)] == [1, 2, 3]


def test_what_is_too_old_goes(tmp_path: Path) -> None:
    """Recordings older than the limit are removed, also the setups that no recording uses any more."""
    run_events(recorder(tmp_path, max_age_days=2), cycles(Status.OK))
    clock = [START_NS]
    other = Recorder(
        RecorderSection(folder=tmp_path, max_age_days=2, min_free_mib=0),
        lambda: ("11111111", {"rig.json": b""}),
        lambda: clock[0],
    )

    def events() -> Iterator[Event]:
        for _ in range(11):
            clock[0] += DAY_NS // 5
            yield replace(make_snapshot(), fingerprint="11111111")
            kept.append(recording.entries(tmp_path)[0].index)

    kept: list[int] = []
    run_events(other, events())

    assert [0] * 10 == kept[:10]
    assert [*range(1, 12)] == [entry.index for entry in recording.entries(tmp_path)]
    assert not recording.setup_folder(tmp_path, FINGERPRINT).exists()
    assert (recording.setup_folder(tmp_path, "11111111") / "rig.json").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("restarted", [False, True])
@pytest.mark.parametrize("days", [31, 3650, -3650])
def test_a_clock_that_is_set_deletes_nothing(tmp_path: Path, days: int, restarted: bool) -> None:
    """A clock that is set a month or ten years ahead, or back, and right again, deletes nothing, also at a
    start."""
    clock = [START_NS]

    def events() -> Iterator[Event]:
        yield from cycles(Status.OK, Status.LOW_QUALITY)
        for wrong_ns in (days * DAY_NS, 0):
            clock[0] = START_NS + wrong_ns
            yield from cycles(Status.OK)

    if restarted:
        pending = list(events())
        for wrong_ns, some in ((0, pending[:4]), (days * DAY_NS, pending[4:6]), (0, pending[6:])):
            clock[0] = START_NS + wrong_ns
            run_events(recorder(tmp_path, clock, max_age_days=30), some)
    else:
        run_events(recorder(tmp_path, clock, max_age_days=30), events())

    assert [0, 1, 2, 3] == [entry.index for entry in recording.entries(tmp_path)]


@pytest.mark.parametrize("year", [1970, 1979, 2120])
def test_any_clock_can_record(tmp_path: Path, year: int) -> None:
    """Recordings work with any year of the clock, though ZIP has only 1980 to 2107."""
    now = [int(datetime(year, 1, 1, tzinfo=UTC).timestamp()) * 10**9]
    writer = recorder(tmp_path, now)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time, "time", lambda: now[0] / 1e9)
        patch.setattr(time, "localtime", lambda _now=None: time.gmtime(now[0] / 1e9))
        run_events(writer, cycles(Status.OK))

    (entry,) = recording.entries(tmp_path)
    assert year == entry.recorded.year
    assert recording.load(entry.path).pair is not None
    assert "" == writer.figures.problem


def test_a_file_with_a_date_that_does_not_exist_is_no_recording(tmp_path: Path) -> None:
    """A file with an impossible date is ignored and kept."""
    (tmp_path / "cycles").mkdir()
    foreign = tmp_path / "cycles" / "000000007_20261345T000000.000000Z_OK_0badcafe.zip"
    foreign.write_bytes(b"")
    run_events(recorder(tmp_path), cycles(Status.OK))

    assert [0] == [entry.index for entry in recording.entries(tmp_path)]
    assert foreign.is_file()


def test_a_fault_that_lasts_or_flutters_is_recorded_once(tmp_path: Path) -> None:
    """A lasting or fluttering fault is recorded once, whatever figures are in its text.

    Another camera is another fault, and so is the same one after a minute's absence.
    """
    now_s = [1000.0]
    writer = Recorder(
        RecorderSection(folder=tmp_path, min_free_mib=0),
        lambda: (FINGERPRINT, {"rig.json": b""}),
        monotonic_s=lambda: now_s[0],
    )

    def events() -> Iterator[Event]:
        texts = ("camera left: 5.1 ms", "camera left: 5.2 ms", "camera right: 5.3 ms", "camera left: 5.4 ms")
        for fault in (*_faults(*texts), *_faults("camera left: 5.5 ms")):
            yield from cycles(Status.OK)
            yield replace(fault, fingerprint=FINGERPRINT)
            now_s[0] += 59.0
        now_s[0] += 2.0
        yield replace(_faults("camera left: 5.6 ms")[0], fingerprint=FINGERPRINT)

    run_events(writer, events())

    recorded = [recording.load(entry.path).snapshot for entry in recording.entries(tmp_path)]
    errors = [snapshot["error"] for snapshot in recorded if snapshot["error"]]
    assert errors == [
        "camera left: 5.1 ms",
        "camera right: 5.3 ms",
        "camera left: 5.4 ms",
        "camera left: 5.6 ms",
    ]


def _faults(*errors: str) -> list[Snapshot]:
    return [
        replace(make_snapshot(n, Status.CAPTURE_FAULT), error=error, error_code=104)
        for n, error in enumerate(errors, 1)
    ]


def test_a_full_disk_is_said_once_and_stops_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Below the limit of free space nothing is written, and one line says so."""
    full = recorder(tmp_path, min_free_mib=100_000_000)
    run_events(full, cycles(*[Status.OK] * 4))

    assert recording.entries(tmp_path) == []
    assert "MiB are free" in full.figures.problem
    assert full.figures.failed == 4
    assert len([r for r in caplog.records if "no recordings" in r.getMessage()]) == 1


def test_a_folder_that_cannot_be_used_stops_nothing(tmp_path: Path) -> None:
    """If the recordings' folder is a file, the cell starts and reports why there are no recordings."""
    (tmp_path / "taken").write_text("")
    blocked = recorder(tmp_path / "taken")
    run_events(blocked, cycles(Status.OK))

    assert str(tmp_path / "taken") in blocked.figures.problem


def test_a_disk_that_comes_late_is_counted_then(tmp_path: Path) -> None:
    """If a disk comes late, its earlier recordings count, and numbers continue after them."""
    disk = tmp_path / "disk"
    run_events(recorder(disk, keep_good=3), cycles(*[Status.OK] * 3))
    disk.rename(tmp_path / "away")
    disk.write_text("the mount point")
    late = recorder(disk, keep_good=3)

    def events() -> Iterator[Event]:
        yield from cycles(Status.OK, first=4)
        disk.unlink()
        (tmp_path / "away").rename(disk)
        yield from cycles(Status.OK, first=5)

    run_events(late, events())

    assert [1, 2, 3] == [entry.index for entry in recording.entries(disk)]
    assert late.figures.kept == 3
    assert "" == late.figures.problem


def test_setups_that_nothing_stands_on_go_at_the_start(tmp_path: Path) -> None:
    """Setups without recordings are removed at the start."""
    run_events(recorder(tmp_path), cycles(Status.OK))
    recording.save_setup(tmp_path, "11111111", {"rig.json": b""})

    run_events(recorder(tmp_path), [])

    assert {FINGERPRINT} == recording.setups(tmp_path)


def test_a_torn_write_is_swept_away(tmp_path: Path) -> None:
    """Unfinished files of a power cut are removed at the start, complete ones stay."""
    run_events(recorder(tmp_path), cycles(Status.OK))
    (tmp_path / "cycles" / ".000000001_x.zip.abc").write_bytes(b"half")
    (tmp_path / "setups" / ".draft").mkdir()

    run_events(recorder(tmp_path), [])

    assert [path.name for path in (tmp_path / "setups").iterdir()] == [FINGERPRINT]
    assert [path.name for path in (tmp_path / "cycles").iterdir()] == [
        entry.path.name for entry in recording.entries(tmp_path)
    ]


def test_a_recorded_miss_says_what_came_nearest(tmp_path: Path) -> None:
    """The recorder asks for the nearest place of a miss, in its own thread."""
    near, looks = NearMiss(Match(1.0, 2.0, 0.1, 1.0, 1.0, 0.5), 0.6), list[str]()

    def look() -> NearMiss:
        looks.append(threading.current_thread().name)
        return near

    missed = replace(make_snapshot(1, Status.NO_TARGET), fingerprint=FINGERPRINT, nearest=Nearest(look))
    run_events(recorder(tmp_path), [ExposureDone(1, None, make_pair(1)), missed])

    (entry,) = recording.entries(tmp_path)
    assert 0.6 == recording.load(entry.path).snapshot["nearest"]["needed_score"]
    (thread,) = looks
    assert thread.startswith("recorder")


def test_good_cycles_are_left_out_first(tmp_path: Path) -> None:
    """If the disk is too slow, good cycles are left out first."""
    slow = recorder(tmp_path)
    run_events(slow, cycles(*[Status.OK] * 5, Status.LOW_QUALITY), pace=False)

    # close drops waiting cycles, so the ring has only those begun; the count shows the choice
    assert slow.figures.left_out == 3


class _StopAfter:
    """An observer that stops the daemon."""

    def __init__(self, number: int) -> None:
        self.daemon: Daemon | None = None
        self.snapshots: list[Snapshot] = []
        self._number = number

    async def start(self) -> None: ...

    def announce(self, event: Event) -> None:
        if isinstance(event, Snapshot):
            self.snapshots.append(event)
            if len(self.snapshots) == self._number and self.daemon is not None:
                self.daemon.stop()

    async def close(self) -> None: ...


def recordings_of(folder: Path, cameras: str = "") -> Path:
    """The recordings of a daemon over three cycles of a virtual cell where nothing moves.

    cameras : further settings of them, as TOML below their table.
    """
    cell = VirtualCell(small_rig(), demo_part())
    path = prepare_cell(folder, cell, DemoOptions(period_s=0.3), gige=False)
    text = (
        path.read_text()
        .replace("port = 1502", "enabled = false")
        .replace("[zenoh]", "[zenoh]\nenabled = false")
        .replace("max_skew_ms = 25.0", f"max_skew_ms = 1000.0\n{cameras}")
    )
    path.write_text(f'{text}\n[recorder]\nfolder = "recordings"\nmin_free_mib = 0\n')
    observer = _StopAfter(3)
    with VirtualWorld(gige=False, rig=small_rig()) as world:
        world.cell.show(Thing.PART, pose())
        observer.daemon = Daemon(path, load_cell(path), observers=[observer], world=world)
        asyncio.run(observer.daemon.run())
    assert [snapshot.status for snapshot in observer.snapshots] == [Status.OK] * 3
    return folder / "recordings"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of a cell that exposes once in a cycle."""
    return recordings_of(tmp_path_factory.mktemp("cell"))


def run_replay(
    path: Path, capsys: pytest.CaptureFixture[str], export: Path | None = None
) -> tuple[int, dict]:
    """The exit code and the report of a replay."""
    code = replay(path, True, Console(), export)
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_a_replay_is_bit_identical(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The replay of a recorded exposure gives every digit again."""
    code, report = run_replay(recorded, capsys)

    assert (code, report["different"], report["skipped"]) == (0, [], [])
    assert report["same"] >= 2


@pytest.mark.slow
def test_a_replay_of_two_exposures_in_a_cycle_is_bit_identical(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With two exposures in a cycle the merged pair is recorded and replays identically.

    The long exposure alone would be white where the merged picture is not.
    """
    cameras = "exposure_ratio = 8\n" + "".join(
        f"[cameras.{side}]\nexposure_us = 8000.0\n" for side in ("left", "right")
    )
    folder = recordings_of(tmp_path, cameras)
    code, report = run_replay(folder, capsys)

    assert (code, report["different"], report["skipped"]) == (0, [], [])
    assert report["same"] >= 2
    pair = recording.load(recording.entries(folder)[0].path).pair
    assert pair is not None
    for frame in (pair.left, pair.right):
        assert 130 < int(frame.image.max()) < 255


@pytest.mark.slow
def test_a_replay_draws_what_it_measured(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A replay draws a picture for each recording, equal to that of `edged locate --overlay`."""
    entry = recording.entries(recorded)[0].path
    overlays = tmp_path / "drawn" / "here"
    assert 0 == replay(entry, True, Console(), overlays=overlays)
    assert [f"{entry.stem}.png"] == [path.name for path in overlays.iterdir()]

    taken = recording.load(entry)
    assert taken.pair is not None
    for side in ("left", "right"):
        cv2.imwrite(str(tmp_path / f"{side}.png"), getattr(taken.pair, side).image)
    setup = recording.setup_folder(recorded, str(taken.snapshot["fingerprint"]))
    job = next(path for path in (setup / "jobs").iterdir())
    pair = tmp_path / "left.png", tmp_path / "right.png"
    located = locate_command(
        setup / "rig.json", job, *pair, True, Console(), LocateOutputs(tmp_path / "located.png")
    )
    assert 0 == located
    assert (tmp_path / "located.png").read_bytes() == (overlays / f"{entry.stem}.png").read_bytes()

    (tmp_path / "taken").write_text("")
    with pytest.raises(FileFormatError, match="taken: is a file, expected a folder"):
        replay(entry, True, Console(), overlays=tmp_path / "taken")


@pytest.mark.slow
def test_an_export_replays_elsewhere(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An export has rig and jobs with the recordings, and replays elsewhere."""
    one = recording.entries(recorded)[0].path
    run_replay(one, capsys, export=tmp_path / "report")

    code, report = run_replay(tmp_path / "report", capsys)

    assert (code, report["same"]) == (0, 1)
    assert json.loads((tmp_path / "report" / "report.json").read_text())["same"] == 1


@pytest.mark.slow
def test_a_difference_is_named(recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A result that differs after an edited limit is reported with the path of the value."""
    run_replay(recorded, capsys, export=tmp_path)
    setup = next((tmp_path / "setups").iterdir())
    job = setup / "jobs" / "flange" / "job.toml"
    job.write_text(job.read_text().replace("max_sigma_mm = 0.2", "max_sigma_mm = 1e-6"))

    code, report = run_replay(tmp_path, capsys)

    assert code == 1
    assert 'status: "OK" -> "LOW_QUALITY"' in report["different"][0]["differences"]


@pytest.mark.slow
def test_the_limits_of_the_cell_are_those_of_the_recording(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The recorded configuration's limits apply at replay; one that is not valid any more is named."""
    run_replay(recorded, capsys, export=tmp_path)
    text = next((tmp_path / "setups").iterdir()) / "cell.toml"
    box = '\n[[limits.box]]\nname = "far"\nmin_mm = [900, 900, 900]\nmax_mm = [901, 901, 901]\n'
    text.write_text(text.read_text() + box)

    code, report = run_replay(tmp_path, capsys)

    assert code == 1
    assert 'status: "OK" -> "LOW_QUALITY"' in report["different"][0]["differences"]
    text.write_text("[limits")
    code, report = run_replay(tmp_path, capsys)
    assert (code, 0) == (1, report["same"])
    assert "cell.toml" in report["skipped"][0]["reason"]


@pytest.mark.slow
def test_without_its_setup_a_recording_is_skipped_with_the_reason(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A recording without its setup is skipped with the reason."""
    source = recording.entries(recorded)[0].path
    (tmp_path / "cycles").mkdir()
    alone = tmp_path / "cycles" / source.name
    alone.write_bytes(source.read_bytes())

    code, report = run_replay(alone, capsys)

    assert code == 1
    assert "its rig and jobs are not there" in report["skipped"][0]["reason"]


def test_a_folder_without_recordings_is_an_error(tmp_path: Path) -> None:
    """A folder without recordings is an error."""
    with pytest.raises(FileFormatError, match="no recordings"):
        replay(tmp_path, True, Console())


def test_compare_names_the_path_and_the_step() -> None:
    """Differences are listed by path in nested lists and objects, numbers with their difference, missing
    keys as null."""
    old = {"a": [1.0, {"b": 2.0}], "gone": 1}
    new = {"a": [1.0, {"b": 2.5}], "new": [1]}

    assert list(compare("x", old, new)) == [
        "x.a[1].b: 2.0 -> 2.5 (+0.5)",
        "x.gone: 1 -> null",
        "x.new: null -> [1]",
    ]
