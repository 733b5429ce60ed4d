#!/usr/bin/env python3
"""Roll releases out to many cells of one machine, attack their repository, and kill the services beside them.

    tools/bench fleet [--cells N] [--json FILE]
    tools/bench fleet --plan N [--json FILE]

All cells but one are light: the product's own client, gate, regression and probation on files of their own,
without daemon and cameras; cycles of their probation are copies of one that was measured. One is a whole
daemon on virtual cameras, with page, history, recorder and Zenoh, and a PLC that triggers it all the time.
Releases come from a static HTTPS server. Prometheus reads all cells, if it is installed (tools/test does).
Only the window of light cells is waited for in virtual time: their gate is asked at noon, then at 23:00.
--plan: what so many cells need per day, computed from artefacts that are made and weighed here.
"""

from __future__ import annotations

import contextlib
import functools
import http.server
import json
import multiprocessing as mp
import os
import re
import shutil
import signal
import sys
import tempfile
import time
import urllib.request
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, ClassVar

import fleetplan
import numpy as np
from benching import bench_parser, finish
from helpers.attacks import (
    by_another_plant,
    by_one_root,
    expired,
    of_another_plant,
    tampered_ring,
    tampered_target,
)
from helpers.gatedcell import NIGHT, NOON, GatedCell, SameProcess, better, edited, gated_cell, turned
from helpers.ports import free_port
from helpers.prometheus import Engine, plant_config, program
from helpers.releases import PASSPHRASE, PLANT, Releases, served
from helpers.webcell import HASH
from rich.console import Console

from edged.errors import UserError
from edged.files.statefolder import page_folder
from edged.setup.fleet.offers import DONE, FOLDER, fetched_in, gate_in, ring_of
from edged.setup.recordings.setups import digest_of
from edged.setup.releases.jobsfolder import jobs_in

REAL = "cell-real"
TOKEN = "a token of the plant"
LATE_S = 5.0
"""TIMEOUT of each command, as the shipped client writes it; a later answer counts as late."""
MOST_S = 60.0
DOWN_S = 8.0
"""Time for which each service is down, and then up before the next one is killed."""
PROBATION = 80
"""Cycles of each light cell in its probation."""
context = mp.get_context("spawn")


# --- processes ------------------------------------------------------------------------------------------


def serve_releases(folder: Path, certificates: Path, port: int) -> None:
    """Run the static server of the repository."""
    with served(folder, certificates, port):
        signal.pause()


def serve_metrics(cells: int, port: int) -> None:
    """Serve /metrics of light cells, each at its own address: 127.1.0.1 is the first."""
    from helpers.snapshots import make_snapshot

    from edged.adapters.metrics import MetricsPublisher

    publishers = [MetricsPublisher(cell_name(number)) for number in range(cells)]

    class Pages(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            """Count one more cycle, and serve the page."""
            third, fourth = map(int, self.request.getsockname()[0].split(".")[2:])
            publisher = publishers[third * 250 + fourth - 1]
            publisher.announce(make_snapshot(1))
            page = publisher.render()
            self.send_response(200)
            self.send_header("Content-Type", "text/plain; version=0.0.4")
            self.send_header("Content-Length", str(len(page)))
            self.end_headers()
            with contextlib.suppress(BrokenPipeError):  # Prometheus was killed, or timed out
                self.wfile.write(page)

        def log_message(self, format: str, *arguments: object) -> None:
            """Log nothing."""

    os.nice(5)
    http.server.ThreadingHTTPServer(("0.0.0.0", port), Pages).serve_forever()


def run_cell(config: Path) -> None:
    """Run the daemon as `edged run` builds it; with a file `covered` beside it, its cameras see nothing."""
    import asyncio

    from helpers.cells import small_rig

    from edged.app.cell import load_any_cell, warm_up
    from edged.app.daemon import Daemon
    from edged.app.process import serve, set_up_process
    from edged.domain.arrays import Image
    from edged.setup.releases.installing import finish_installation
    from edged.sim.exposure import ExposureRequest
    from edged.sim.inprocess import InProcessCamera
    from edged.sim.world import VirtualWorld

    class Coverable(VirtualWorld):
        def in_process_cameras(self) -> tuple[InProcessCamera, InProcessCamera]:
            """Cameras whose view can be covered."""
            sizes = {"width": self.cell.rig.left.width, "height": self.cell.rig.left.height}
            left, right = (
                InProcessCamera(side, functools.partial(seen, self.cell.exposure(side)), **sizes)
                for side in ("left", "right")
            )
            return left, right

    def seen(exposure: Callable[[ExposureRequest], Image], request: ExposureRequest) -> Image:
        image = exposure(request)
        return np.zeros_like(image) if config.with_name("covered").exists() else image

    with config.with_name("log").open("ab") as log:
        os.dup2(log.fileno(), 2)
    set_up_process()
    finish_installation(config)
    loaded = load_any_cell(config)
    warm_up(loaded)
    with Coverable(gige=False, rig=small_rig()) as world:
        asyncio.run(serve(lambda: Daemon(config, loaded, world=world)))


def trigger(port: int, notes: Path) -> None:
    """Locate as a PLC, at most ten times a second; note when, how it ended and how long it took."""
    from edged.robots.cell_client import CellError, CommandNacked, EdgedCell

    with notes.open("w", buffering=1) as file:
        while True:
            with contextlib.suppress(CellError), EdgedCell("127.0.0.1", port=port) as plc:
                while True:
                    begun_s = time.monotonic()
                    try:
                        result = plc.locate(timeout_s=LATE_S)
                        how = str(result.code)
                        plc.acknowledge(result)
                    except CommandNacked as error:
                        how = f"nack {error}"
                    except CellError as error:
                        how = f"none {error}"
                    file.write(json.dumps([begun_s, time.monotonic() - begun_s, how]) + "\n")
                    time.sleep(0.1)


def listen(port: int, notes: Path) -> None:
    """Note every result received over the router."""
    import zenoh

    config = zenoh.Config()
    for key, value in {
        "mode": "client",
        "scouting/multicast/enabled": False,
        "connect/endpoints": [f"tcp/127.0.0.1:{port}"],
        "connect/timeout_ms": -1,
    }.items():
        config.insert_json5(key, json.dumps(value))
    with notes.open("w", buffering=1) as file, zenoh.open(config) as session:
        session.declare_subscriber(f"edged/{REAL}/target", lambda _: file.write(f"{time.monotonic()}\n"))
        signal.pause()


def route(port: int) -> None:
    """Run a Zenoh router."""
    import zenoh

    config = zenoh.Config()
    for key, value in {
        "mode": "router",
        "scouting/multicast/enabled": False,
        "listen/endpoints": [f"tcp/127.0.0.1:{port}"],
    }.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        signal.pause()


@dataclass
class BenchProcess:
    """A process of the bench that can be killed and restarted."""

    target: Callable[..., None]
    arguments: tuple[object, ...]
    process: BaseProcess | None = None

    def start(self) -> None:
        """Start the process."""
        self.process = context.Process(target=self.target, args=self.arguments, daemon=True)
        self.process.start()

    def kill(self) -> None:
        """Kill it, as a power cut would."""
        if self.process is not None:
            self.process.kill()
            self.process.join()


# --- light cells ----------------------------------------------------------------------------------------


def cell_name(number: int) -> str:
    """Name of a cell by its number."""
    return f"cell-{number:04}"


def lesser() -> None:
    """Lower this process's priority below the daemon's."""
    os.nice(5)
    os.environ["OPENBLAS_NUM_THREADS"] = "1"


def pulled(config: Path, place: str | None = None) -> str:
    """Run `edged release pull`; return the staged release, or why it was refused."""
    from edged.commands.release import pull

    with Path(os.devnull).open("w") as nowhere:
        try:
            pull(config, Console(file=nowhere), place=place, name=None, output=None)
        except UserError as error:
            return f"refused: {error}"
    there = fetched_in(page_folder(config) / FOLDER)
    return "" if there is None else there.offer.name


def attacked(config: Path, place: str) -> str:
    """Return `pulled` from an attacked repository, and restore the cell's state afterwards."""
    kept = page_folder(config) / FOLDER
    before = shutil.copytree(kept, kept.with_name("before"))
    said = pulled(config, place)
    shutil.rmtree(kept)
    before.rename(kept)
    return said


class MeasuredOnce(SameProcess):
    """Light cells share their recordings: each process measures them once per set of jobs."""

    known: ClassVar[dict[tuple[Any, ...], Any]] = {}

    async def run(self, name: str, *arguments: Any) -> Any:
        """Do the work of the worker process."""
        entries, active, candidate, _ = arguments
        files = tuple(entry.path.stat().st_ino for entry in entries)
        key = name, files, digest_of(active), digest_of(candidate)
        if key not in self.known:
            self.known[key] = await super().run(name, *arguments)
        return [*self.known[key]]


@functools.cache
def pairs_of(template: Path) -> list[Any]:
    """Pictures of the template, cached."""
    return [np.load(template.with_name("pairs.npy"), allow_pickle=True)[0]]


def gated(folder: Path, template: Path) -> tuple[str, str, str]:
    """Take a cell's gate to its end, at noon, then at night; return name, last step and why."""
    import asyncio

    async def whole_way() -> tuple[str, str, str]:
        cell = GatedCell(folder, pairs_of(template), NOON, MeasuredOnce())
        note = await cell.reach("waiting", *DONE)
        if note.step == "waiting" and (await cell.step()).step == "waiting":
            cell.now = NIGHT
            note = await cell.reach("probation", *DONE)
            while note.step == "probation":
                cell.measure(PROBATION)
                note = await cell.step()
        return folder.name, note.step, note.why

    return asyncio.run(whole_way())


# --- the fleet ------------------------------------------------------------------------------------------


@dataclass
class Bench:
    """A fleet in a folder. figures : printed results, for JSON."""

    folder: Path
    count: int
    pool: ProcessPoolExecutor
    figures: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Make keys and cells; start nothing."""
        ports = {name: free_port() for name in ("modbus", "web", "zenoh", "releases", "metrics", "router")}
        self.ports = ports
        self.releases = Releases(self.folder / "fleet")
        with quiet():
            self.releases.make()
        template = gated_cell(self.folder / "template")
        self.template = template.folder
        template.measure(60)
        np.save(
            self.folder / "pairs.npy", np.array([template.pairs[0], None], dtype=object), allow_pickle=True
        )
        self.names = [REAL, *(cell_name(number) for number in range(self.count - 1))]
        self.listed = self.folder / "cells.txt"
        self.listed.write_text("\n".join(self.names))
        self.certificates = self.folder / "tls"
        for name in self.names:
            self._make(self.folder / "cells" / name)
        self.prometheus: Engine | None = None
        if program("prometheus"):
            light = [f"127.1.{i // 250}.{i % 250 + 1}:{ports['metrics']}" for i in range(self.count - 1)]
            place = self.folder / "prometheus"
            place.mkdir()
            config = plant_config(place, [f"127.0.0.1:{ports['web']}", *light], token=TOKEN, every="15s")
            self.prometheus = Engine("prometheus", place, f"--config.file={config}")
        self.server = BenchProcess(
            serve_releases, (self.releases.repository, self.certificates, ports["releases"])
        )
        self.router = BenchProcess(route, (ports["router"],))
        self.plc_notes, self.heard_notes = self.folder / "plc.txt", self.folder / "heard.txt"
        self.others = [
            BenchProcess(serve_metrics, (self.count, ports["metrics"])),
            BenchProcess(run_cell, (self.config(REAL),)),
            BenchProcess(trigger, (ports["modbus"], self.plc_notes)),
            BenchProcess(listen, (ports["router"], self.heard_notes)),
        ]

    def config(self, name: str) -> Path:
        """Configuration of a cell."""
        return self.folder / "cells" / name / "cell.toml"

    def _make(self, folder: Path) -> None:
        """Make a cell; its recordings, which never change, are hard links."""
        shutil.copytree(self.template, folder, ignore=shutil.ignore_patterns("recordings"))
        shutil.copytree(self.template / "recordings", folder / "recordings", copy_function=os.link)
        config = folder / "cell.toml"
        text = config.read_text().replace('name = "demo"', f'name = "{folder.name}"')
        text = text.replace('"/stick"', f'"https://127.0.0.1:{self.ports["releases"]}"')
        text = text.replace('"root.json"', f'"{self.releases.root}"')
        if folder.name == REAL:
            text = text.replace('window = "22:00-05:00"\n', "").replace('mode = "free"', 'mode = "command"')
            text = text.split("[modbus]")[0] + f"[modbus]\nport = {self.ports['modbus']}\n" + (
                f'[zenoh]\nlisten = []\nconnect = ["tcp/127.0.0.1:{self.ports["router"]}"]\n'
                f'[web]\nport = {self.ports["web"]}\npassword_hash = "{HASH}"\ncommissioning = true\n'
                f'metrics_password_hash = "{token_hash()}"\n'
                f'[history]\nfolder = "{self.folder / "store"}"\nplant = "{PLANT}"\nmin_free_mib = 0\n'
                + "[recorder]\nkeep_good = 60" + text.split("[recorder]")[1]
            )  # fmt: skip
        config.write_text(text)

    @contextlib.contextmanager
    def running(self) -> Iterator[None]:
        """Run everything; yields once the daemon has measured."""
        all_of_it = [self.server, self.router, *self.others]
        try:
            self.server.start()
            self.router.start()
            if self.prometheus is not None:
                self.prometheus.start()
            for process in self.others:
                process.start()
            self.until(
                lambda: len(self.plc(0.0)) > 20 and self.certificates.joinpath("ca.pem").exists(), 300.0
            )
            yield
        finally:
            for process in reversed(all_of_it):
                process.kill()
            if self.prometheus is not None:
                self.prometheus.kill()

    def until(self, holds: Callable[[], bool], most_s: float) -> float:
        """Wait until a condition holds; return how long. Raises `TimeoutError`."""
        begun_s = time.monotonic()
        while not holds():
            if time.monotonic() - begun_s > most_s:
                raise TimeoutError(f"after {most_s:g} s")
            time.sleep(0.2)
        return time.monotonic() - begun_s

    def plc(self, since_s: float) -> list[tuple[float, float, str]]:
        """Notes of the PLC: when, seconds, how."""
        lines = self.plc_notes.read_text().splitlines() if self.plc_notes.exists() else []
        return [(at, took, how) for at, took, how in map(json.loads, lines) if at >= since_s]

    def release(self, name: str, *arguments: object) -> float:
        """Sign and publish a release; return when."""
        with quiet():
            if self.releases.sign(name, *arguments, "--cells", self.listed) or self.releases.publish():
                raise RuntimeError(f"{name} could not be signed")
        return time.monotonic()

    def pull(self) -> Counter[str]:
        """Let every cell pull, the daemon's first; count the staged releases."""
        real = pulled(self.config(REAL))
        self.asked_s = time.monotonic()
        return Counter([real, *self.pool.map(pulled, map(self.config, self.names[1:]), chunksize=8)])

    def real_step(self) -> tuple[str, str]:
        """Step of the daemon's gate, and its release."""
        gate = gate_in(page_folder(self.config(REAL)) / FOLDER)
        return ("", "") if gate is None else (gate.step, gate.staged.offer.name)

    def pass_gates(self, names: Sequence[str]) -> Counter[str]:
        """Take the release of light cells through their gates; count the last steps."""
        folders = [self.folder / "cells" / name for name in names if name != REAL]
        found = [*self.pool.map(gated, folders, [self.template] * len(folders), chunksize=2)]
        odd = next((row for row in found if row[1] != found[0][1]), None)
        if odd is not None:
            print(f"  {odd[0]}: {odd[1]}: {odd[2]}", flush=True)
        return Counter(step for _, step, _ in found)

    def named(self, stem: str) -> str:
        """Name of a release whose ring 1 is the daemon; the order depends on the name's SHA-256."""
        return next(name for name in (f"{stem}-{number}" for number in range(100_000)) if self.is_first(name))

    def is_first(self, release: str) -> bool:
        """Whether the daemon is the release's ring 1."""
        return ring_of(REAL, release, self.names) == 1

    # --- what is shown --------------------------------------------------------------------------------

    def good_release(self) -> None:
        """Roll out a release like the one before, ring by ring."""
        name, jobs = self.named("good"), self.jobs("good", better)
        print(
            "| ring | cells that have fetched it | committed | from its publication, s |\n|---|---|---|---|"
        )
        rows, done = [], set[str]()
        for ring in ("1", "5%", "25%", "all"):
            begun_s = self.release(name, *(("--jobs", jobs) if ring == "1" else ()), "--ring", ring)
            fetched = self.pull()[name]
            due = [cell for cell in self.names if ring_of(cell, name, self.names) <= RING[ring]]
            steps = self.pass_gates([cell for cell in due if cell not in done])
            if ring == "1":
                self.until(lambda: self.real_step() in {(step, name) for step in DONE}, 900.0)
            done |= {*due}
            steps += Counter(gate.step for cell in done if (gate := self.gate(cell)))
            committed = sum(1 for cell in done if (gate := self.gate(cell)) and gate.step == "committed")
            rows.append([ring, fetched, committed, round(time.monotonic() - begun_s)])
            print(f"| {ring} | {fetched} | {committed} | {rows[-1][3]} |", flush=True)
        self.figures["good release"] = rows

    def gate(self, cell: str) -> Any:
        """Note of a cell's gate."""
        return gate_in(page_folder(self.config(cell)) / FOLDER)

    def jobs(self, name: str, change: Callable[[str], str]) -> Path:
        """Make a folder of jobs with a changed text."""
        folder = self.folder / name
        for place, data in edited(self.config(REAL).parent, change).items():
            (folder / place).parent.mkdir(parents=True, exist_ok=True)
            (folder / place).write_bytes(data)
        return folder

    def turned_release(self) -> None:
        """Roll out a release that turns the part by 180 degrees, and may move results by a metre."""
        name, before = self.named("turned"), jobs_in(self.config(REAL).parent / "jobs")
        jobs = self.jobs("turned", turned)
        self.release(name, "--jobs", jobs, "--ring", "1", "--may-move", 1000)
        fetched = self.pull()[name]
        self.until(lambda: self.real_step() in {(step, name) for step in DONE}, 600.0)
        stopped_s = time.monotonic() - self.asked_s
        step = self.real_step()[0]
        same = before == jobs_in(self.config(REAL).parent / "jobs")
        print(f"turned by 180 degrees, ring 1: fetched by {fetched}, {step} within {stopped_s:.0f} s, "
              f"{self.count - fetched} cells without it; never active: {same}", flush=True)  # fmt: skip
        self.release(name, "--ring", "25%")
        careless = self.pull()[name]
        steps = self.pass_gates(
            [cell for cell in self.names if ring_of(cell, name, self.names) <= RING["25%"]]
        )
        print(f"  widened to 25 % by mistake: fetched by {careless}, light cells: {dict(steps)}", flush=True)
        self.figures["turned"] = [fetched, step, stopped_s, same, careless, dict(steps)]
        self.release(name, "--ring", "none")

    def worse_release(self) -> None:
        """Roll out a release that recordings accept, but that finds nothing once it is active."""
        name, place = self.named("worse"), self.config(REAL)
        lid = place.with_name("covered")
        jobs = self.jobs("worse", lambda text: text.replace("max_sigma_mm = 0.2", "max_sigma_mm = 0.22"))
        before = jobs_in(place.parent / "jobs")
        self.release(name, "--jobs", jobs, "--ring", "1")
        pulled(place)
        self.until(lambda: self.real_step() == ("probation", name), 900.0)
        lid.touch()
        back_s = self.until(lambda: self.real_step() == ("rolled back", name), 900.0)
        lid.unlink()
        fetched = self.pull()[name]
        same = before == jobs_in(place.parent / "jobs")
        print(f"good on recordings, then blind, ring 1: fetched by {fetched}, back after {back_s:.0f} s "
              f"(<= {MOST_S:g}: {back_s <= MOST_S}), files as before: {same}", flush=True)  # fmt: skip
        self.figures["worse"] = [fetched, back_s, same]
        self.release(name, "--ring", "none")

    def attacks(self) -> None:
        """Attack a release for all, which no cell has yet, by changing the repository."""
        baited = Releases(shutil.copytree(self.releases.keys.parent, self.folder / "baited"))
        with quiet():
            baited.sign("bait", "--jobs", self.template / "jobs", "--ring", "all")
            baited.publish()
        print("| repository | refused |\n|---|---|")
        tried = tampered_target, tampered_ring, of_another_plant, by_another_plant, expired, by_one_root
        rows = []
        for attack in (*tried, None):
            name = "older than seen" if attack is None else attack.__name__.replace("_", " ")
            copy = Releases(shutil.copytree(baited.keys.parent, self.folder / "attacks" / name))
            if attack is None:
                shutil.rmtree(copy.repository)
                shutil.copytree(self.folder / "older", copy.repository)
            else:
                attack(copy)
            configs = [*map(self.config, self.names)]
            said = [*self.pool.map(attacked, configs, [str(copy.repository)] * len(configs), chunksize=8)]
            refused = sum(text.startswith("refused") for text in said)
            taken = sum(text == "bait" for text in said)
            rows.append([name, refused, taken])
            print(f"| {name} | {refused} of {len(said)}, {taken} have taken it |", flush=True)
        self.figures["attacks"] = rows

    def kills(self) -> None:
        """Kill services one after the other, then all at once, and watch the PLC."""
        store, away = self.folder / "store", self.folder / "store-away"

        def store_goes() -> None:
            store.rename(away)
            store.write_text("no folder\n")

        def store_comes() -> None:
            store.unlink()
            away.rename(store)

        engines: dict[str, tuple[Callable[[], None], Callable[[], None]]] = {
            "repository": (self.server.kill, self.server.start),
            "router": (self.router.kill, self.router.start),
            "store": (store_goes, store_comes),
        }
        if self.prometheus is not None:
            engines["Prometheus"] = self.prometheus.kill, self.prometheus.start
        phases = [(name, [name]) for name in engines]
        phases.append(("all at once", [*engines]))
        print("| killed | commands | late | p50, ms | p99 | longest |\n|---|---|---|---|---|---|")
        rows = []
        for title, names in phases:
            quiet_s = time.monotonic()
            time.sleep(2 * DOWN_S)
            begun_s = time.monotonic()
            for name in names:
                engines[name][0]()
            time.sleep(DOWN_S)
            for name in names:
                engines[name][1]()
            time.sleep(DOWN_S)
            for what, since_s, until_s in (("nothing", quiet_s, begun_s), (title, begun_s, time.monotonic())):
                rows.append(self.row(what, since_s, until_s))
                print("| " + " | ".join(map(str, rows[-1])) + " |", flush=True)
        self.until(lambda: not pulled(self.config(REAL)).startswith("refused"), 5 * MOST_S)
        self.figures["kills"] = rows

    def row(self, title: str, since_s: float, until_s: float = np.inf) -> list[Any]:
        """Row for the commands of a period: how many, late ones, and their durations."""
        noted = [note for note in self.plc(since_s) if note[0] < until_s]
        took_ms = [1e3 * took for _, took, _ in noted]
        late = sum(took > LATE_S for _, took, _ in noted)
        p50, p99 = np.percentile(took_ms, (50, 99))
        return [title, len(noted), late, round(p50), round(p99), round(max(took_ms))]

    def check_recovery(self) -> None:
        """Check at the end that every service has recovered, and the store against the number of cycles."""
        restarted_s = time.monotonic()
        again = self.until(lambda: not pulled(self.config(REAL)).startswith("refused"), MOST_S)
        heard = self.until(lambda: self.last_heard() > restarted_s, MOST_S)
        print(f"afterwards: a cell pulls after {again:.0f} s, the router carries after {heard:.0f} s")
        if self.prometheus is not None:
            took = self.until(lambda: self.read_by_prometheus() == self.count, 5 * MOST_S)
            print(f"  Prometheus reads all {self.count} cells after {took:.0f} s", flush=True)
        self.others[2].kill()  # the PLC
        time.sleep(3.0)
        cycles, left_out = self.metric("edged_cycles_total"), self.metric("edged_history_left_out")
        daemon = self.others[1].process
        if daemon is not None and daemon.pid is not None:
            os.kill(daemon.pid, signal.SIGTERM)
            daemon.join(MOST_S)
        rows = self.kept_rows()
        print(
            f"  {cycles:.0f} cycles: {rows} rows in the store, {left_out:.0f} counted as left out, "
            f"{cycles - rows - left_out:.0f} missing without a word",
            flush=True,
        )
        self.figures["store"] = [cycles, rows, left_out]

    def last_heard(self) -> float:
        """Time when the newest result came over the router."""
        return max(map(float, self.heard_notes.read_text().splitlines()), default=0.0)

    def read_by_prometheus(self) -> int:
        """Number of cells that Prometheus reads."""
        found = [] if self.prometheus is None else self.prometheus.query("sum(up)")
        return int(found[0]["value"][1]) if found else 0

    def metric(self, name: str) -> float:
        """A figure of the daemon's /metrics, summed over all labels."""
        request = urllib.request.Request(f"http://127.0.0.1:{self.ports['web']}/metrics")
        request.add_header("Authorization", f"Bearer {TOKEN}")
        with urllib.request.urlopen(request, timeout=MOST_S) as answer:
            lines = answer.read().decode().splitlines()
        return sum(float(line.rsplit(" ", 1)[1]) for line in lines if re.split("[{ ]", line)[0] == name)

    def kept_rows(self) -> int:
        """Pack what is left, as the next start does, and count the rows."""
        from edged.files.history.packing import pack
        from edged.files.history.query import ask
        from edged.files.history.rows import FULL, OPEN, spool_folder

        store = self.folder / "store"
        for left in spool_folder(store, REAL).glob(f"*{OPEN}"):
            left.rename(left.with_suffix(FULL))
        pack(store, PLANT, REAL, 400, 2000)
        _, rows = ask([store], "SELECT count(*) FROM cycles")
        return int(rows[0][0])


RING = {"1": 1, "5%": 2, "25%": 3, "all": 4}


@functools.cache
def token_hash() -> str:
    """Hash of the token of /metrics."""
    from argon2 import PasswordHasher

    return PasswordHasher(time_cost=1, memory_cost=512, parallelism=1).hash(TOKEN)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Suppress the output of commands."""
    with Path(os.devnull).open("w") as nowhere, contextlib.redirect_stdout(nowhere):
        yield


def bench(folder: Path, cells: int) -> dict[str, Any]:
    """Run all parts, and return the figures."""
    os.environ["EDGED_PASSPHRASE"] = PASSPHRASE
    os.environ["SSL_CERT_FILE"] = str(folder / "tls" / "ca.pem")
    with ProcessPoolExecutor(2, context, lesser) as pool:
        begun_s = time.monotonic()
        fleet = Bench(folder, cells, pool)
        with fleet.running():
            fleet.release("first", "--jobs", fleet.template / "jobs", "--ring", "none")
            shutil.copytree(fleet.releases.repository, folder / "older")
            print(
                f"{cells} cells, one of them a daemon; made in {time.monotonic() - begun_s:.0f} s", flush=True
            )
            for show in (
                fleet.kills,
                fleet.turned_release,
                fleet.worse_release,
                fleet.attacks,
                fleet.good_release,
            ):
                show()
            noted = fleet.plc(0.0)
            print(f"the PLC meanwhile: {fleet.row('', 0.0)[1:]} of {len(noted)}", flush=True)
            fleet.check_recovery()
    return fleet.figures


def planned(folder: Path, cells: int) -> list[list[Any]]:
    """Print the table for `cells` cells."""
    os.environ["EDGED_PASSPHRASE"] = PASSPHRASE
    releases = Releases(folder / "fleet")
    with quiet():
        releases.make()
    cell = gated_cell(folder / "cell").folder / "cell.toml"
    port = free_port()
    text = (
        cell.read_text().split("[modbus]")[0] + f"[modbus]\nport = {free_port()}\n[zenoh]\nenabled = false\n"
    )
    text += f'[web]\nport = {port}\n[recorder]\nfolder = "recordings"\nmin_free_mib = 0\n'
    cell.write_text(text + f'[history]\nfolder = "{folder / "store"}"\nmin_free_mib = 0\n')
    daemon = BenchProcess(run_cell, (cell,))
    daemon.start()
    try:
        page = fleetplan.page_of(port, 3)
    finally:
        daemon.kill()
    with quiet():
        rows = fleetplan.plan(folder / "plan", cells, page, releases, cell.parent / "jobs")
    for number, row in enumerate(rows):
        print("| " + " | ".join(row) + " |" + ("\n|---|---|---|" if number == 0 else ""))
    return rows


def main() -> None:
    """Run what was asked for."""
    parser = bench_parser(__doc__)
    parser.add_argument("--cells", type=int, default=12)
    parser.add_argument("--plan", type=int, help="only the plan of so many cells")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="edged-fleet-") as place:
        figures: Any = None
        if options.plan is not None:
            figures = planned(Path(place), options.plan)
        else:
            figures = bench(Path(place), options.cells)
    finish(options, figures)


if __name__ == "__main__":
    sys.exit(main())
