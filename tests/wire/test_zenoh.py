"""Zenoh over real sockets, the other end in another process."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import logging
import queue
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
import zenoh
from helpers.ports import free_port
from helpers.schema_check import load_schema, violations
from helpers.snapshots import make_snapshot
from helpers.waiting import LIMIT_S, until
from helpers.zenohcell import READY, Cell, Peer, ask, ignore, is_message, peer

from edged.adapters.zenoh import (
    ZenohPublisher,
    ZenohSettings,
    open_session,
    preview,
    ros2,
    session,
    session_config,
)
from edged.adapters.zenoh.publisher import PATIENCE, Routers
from edged.adapters.zenoh.triggers import parse_trigger
from edged.adapters.zenoh.worker import JobThread
from edged.domain.events import (
    Basis,
    Command,
    CommandFailed,
    CommandKind,
    ExposureDone,
    JobChanged,
    Registered,
)
from edged.domain.frames import Frame, FramePair
from edged.domain.measurement import Status
from edged.domain.registration import Method, Obstacle, Registration
from edged.errors import CommandRefused, ConfigError, ListenError

SCHEMA = load_schema()


def listener(port: int) -> contextlib.AbstractContextManager[Peer]:
    """A process that subscribes to every cell at this port."""
    return peer("listen", mode="peer", listen__endpoints=[], connect__endpoints=[f"tcp/127.0.0.1:{port}"])


def python_threads() -> set[str]:
    """Names of the running threads, except those of the test's own executor."""
    return {thread.name for thread in threading.enumerate() if not thread.name.startswith("asyncio_")}


REGISTERED = Registration(Method.HAND_EYE, 10, 9, 4, rms_mm=0.02)


@pytest.mark.slow
async def test_every_cycle_arrives_in_order_and_documented():
    """A subscriber in another process sees each cycle once, in order, as the schema says."""
    async with Cell() as cell:
        with listener(cell.port) as other:
            lines = []
            for cycle in range(1, 21):
                cell.publisher.announce(make_snapshot(cycle, list(Status)[cycle % len(Status)]))
                # each is received before the next is sent: under load the publisher drops some of a burst
                lines.append(await other.until(is_message("target")))
            health = await other.until(is_message("health", cycles=20))
            *targets, health = [line["document"] for line in (*lines, health)]
    assert [*range(1, 21)] == [target["cycle"] for target in targets]
    assert [*range(1, 21)] == [target["sequence"] for target in targets]
    assert 1_700_000_000_000_000_000 == targets[3]["exposed_ns"]
    assert [] == [
        problem for message in (*targets, health) for problem in violations(message, SCHEMA, SCHEMA)
    ]
    assert {"OK": 5, "NO_TARGET": 5, "LOW_QUALITY": 5, "CAPTURE_FAULT": 5} == health["cycles_by_status"]


async def test_who_comes_late_gets_the_last_result_and_state():
    """A subscriber that appears after the last cycle receives it without another one."""
    async with Cell() as cell:
        cell.publisher.announce(READY)
        for cycle in (1, 2, 3):
            cell.publisher.announce(make_snapshot(cycle))
        with listener(cell.port) as other:
            await other.until(is_message("target", cycle=3))
            other.close()
        with listener(cell.port) as other:
            await other.until(is_message("state", state="READY", job="flange"))


async def test_a_trigger_is_answered_by_the_result_it_asked_for():
    """The reply is the result of its own command, not of another cycle."""
    async with Cell() as cell:

        def react(command: Command) -> None:
            cell.publisher.announce(make_snapshot(7))
            cell.publisher.announce(make_snapshot(8, command=Command(CommandKind.LOCATE, "modbus", 1)))
            cell.publisher.announce(make_snapshot(9, command=command))

        cell.commander.react = react
        (reply,) = await ask(cell.port, "edged/cell1/trigger?job=2;kind=grab;flange=500,0,700,0,1,0,0")
    assert reply["ok"]
    assert 9 == reply["document"]["cycle"]
    command = {"kind": "GRAB", "source": "zenoh", "sequence": 1, "job": 2, "box": 0, "skipped_mm": None}
    flange = [[1, 0, 0, 500], [0, -1, 0, 0], [0, 0, -1, 700], [0, 0, 0, 1]]
    assert {**command, "robot_from_flange": flange} == reply["document"]["command"]
    assert [] == violations(reply["document"], SCHEMA, SCHEMA)


async def test_a_trigger_ends_in_exactly_one_answer_whatever_happens():
    """Refused, failed later, timed out or job changed: each gets exactly one reply, and nothing stays
    pending."""
    async with Cell() as cell:

        def refuse(command: Command) -> None:
            raise CommandRefused("queue full")

        reactions = iter(
            [
                refuse,
                lambda command: cell.publisher.announce(CommandFailed(command, "job 2 is gone")),
                ignore,
                lambda command: cell.publisher.announce(JobChanged(2, "cover", command)),
                lambda command: cell.publisher.announce(Registered(command, REGISTERED, None, "it fits")),
                lambda command: cell.publisher.announce(
                    Registered(command, REGISTERED, Obstacle.NOT_SEEN, "too dark")
                ),
            ]
        )
        cell.commander.react = lambda command: next(reactions)(command)
        selectors = ("", "?job=2", "?timeout_s=0.2", "?kind=change_job;job=2")
        selectors += ("?kind=register_solve", "?kind=register_add;flange=1,2,3,1,0,0,0")
        replies = await ask(cell.port, *(f"edged/cell1/trigger{selector}" for selector in selectors))
        cell.publisher.announce(make_snapshot(command=cell.commander.commands[2]))  # too late, without effect
    assert [False, False, False, True, True, False] == [reply["ok"] for reply in replies]
    errors = [reply["document"].get("error") for reply in replies]
    assert [
        "queue full",
        "job 2 is gone",
        "no result within 0.2 s",
        None,
        None,
        "NOT_SEEN: too dark",
    ] == errors
    assert "cover" == replies[3]["document"]["job"]
    solved = replies[4]["document"]
    assert ("HAND_EYE", 10, 0.02, None) == tuple(
        solved[name] for name in ("method", "samples", "rms_mm", "held_out_mm")
    )
    assert (1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0) == cell.commander.commands[5].shown
    assert [] == [problem for reply in replies for problem in violations(reply["document"], SCHEMA, SCHEMA)]
    assert CommandKind.CHANGE_JOB is cell.commander.commands[3].kind


def test_a_job_is_the_number_that_is_written():
    """A job number with leading zeros is read as a whole."""
    assert 121 == parse_trigger(zenoh.Parameters("job=0000121"), 5.0).job


async def test_wrong_parameters_are_refused_with_what_was_expected():
    """Invalid parameters are refused with the expected values, and no command is submitted."""
    bad = {
        "kind=melt": "kind: expected one of locate, change_job, grab, verify, hand_eye_start, touch_start, "
        "register_add, register_solve, golden, got 'melt'",
        "job=-1": "job: expected a number from 0 to 65535, or all, got '-1'",
        "job=99999999999999999999": "job: expected a number from 0 to 65535, or all, got "
        "'99999999999999999999'",
        "job=²": "job: expected a number from 0 to 65535, or all, got '²'",
        "timeout_s=1_0": "timeout_s: expected seconds up to 60, got '1_0'",
        "timeout_s=nan": "timeout_s: expected seconds up to 60, got 'nan'",
        "timeout_s=1e9": "timeout_s: expected seconds up to 60, got '1e9'",
        "jbo=1": "unknown parameter 'jbo', expected kind, job, timeout_s, flange, nonce",
        "flange=1,2,3": "flange: expected 7 numbers "
        "(x y z in mm, quaternion q1 q2 q3 q4 (scalar first)), got 3",
        "flange=1,2,3,1,0,0,one": "flange: expected a finite number, got 'one'",
        "flange=1_0,2,3,1,0,0,0": "flange: expected a finite number, got '1_0'",
        "flange=1,2,3,1,1,0,0": "flange: the quaternion has the length 1.4142, expected 1",
    }
    async with Cell() as cell:
        replies = await ask(cell.port, *(f"edged/cell1/trigger?{text}" for text in bad))
    assert list(bad.values()) == [reply["document"]["error"] for reply in replies]
    assert [] == cell.commander.commands


async def test_looking_around_with_wildcards_triggers_nothing():
    """`get edged/**` reads what can be read and triggers nothing."""
    async with Cell() as cell:
        cell.publisher.announce(READY)
        cell.publisher.announce(make_snapshot(5))
        replies = await ask(cell.port, "edged/**", "edged/*/trigger")
    assert [] == cell.commander.commands
    by_schema = {reply["document"]["schema"]: reply["document"] for reply in replies}
    assert {"edged/target/1", "edged/jobs/1", "edged/config/1", "edged/error/1"} == by_schema.keys()
    assert 5 == by_schema["edged/target/1"]["cycle"]
    assert {"calibration": "cal"} == by_schema["edged/config/1"]["config"]
    jobs = [{"number": 1, "name": "flange", "active": True}, {"number": 2, "name": "cover", "active": False}]
    assert jobs == by_schema["edged/jobs/1"]["jobs"]
    assert [] == [
        problem for document in by_schema.values() for problem in violations(document, SCHEMA, SCHEMA)
    ]


async def test_last_says_how_old_it_is_and_when_there_is_none():
    """Before the first cycle and after a reload `last` is an error, otherwise the result and its age."""
    async with Cell() as cell:
        before = await ask(cell.port, "edged/cell1/last")
        snapshot = make_snapshot(4)
        late = dataclasses.replace(snapshot, published_ns=snapshot.exposed_ns + 10_000_000_000)
        cell.publisher.announce(late)
        after = await ask(cell.port, "edged/cell1/last")
        cell.publisher.announce(Basis(1, "cal", "beef"))
        before, after, reloaded = before + after + await ask(cell.port, "edged/cell1/last")
    for without in (before, reloaded):
        assert without["document"]["error"] == "nothing has been measured since the start or the last reload"
    # the stamps are years old: setting the clock makes no result younger or older
    assert 10_000 <= after["document"]["age_ms"] < 10_000 + 1000 * LIMIT_S
    assert [] == violations(after["document"], SCHEMA, SCHEMA)


async def test_the_liveliness_token_goes_with_the_cell():
    """`alive` appears with the cell and is withdrawn when it ends, without any message from it."""

    def alive(kind: str) -> Callable[[dict[str, Any]], bool]:
        return lambda line: (line.get("key"), line.get("kind")) == ("edged/cell1/alive", kind)

    with contextlib.ExitStack() as stack:
        async with Cell() as cell:
            other = stack.enter_context(listener(cell.port))
            await other.until(alive("put"))
        await other.until(alive("delete"))


async def test_closing_answers_who_waits_and_leaves_no_thread():
    """A pending trigger gets an error at once, and no thread is left."""
    before = python_threads()
    async with Cell() as cell:
        cell.publisher.announce(READY)
        asked = asyncio.create_task(ask(cell.port, "edged/cell1/trigger?timeout_s=60"))
        await cell.commander.came.wait()
        await cell.publisher.close()
        cell.publisher.announce(make_snapshot())  # the loop may still announce, without effect
        (reply,) = await asked
    assert "the daemon is stopping" == reply["document"]["error"]
    await until(lambda: python_threads() <= before)


async def test_a_port_in_use_is_a_listen_error_that_names_it():
    """A second cell at the same endpoint raises an error that names it, and leaves nothing behind."""
    before = python_threads()
    async with Cell() as cell:
        rival = ZenohPublisher(ZenohSettings("cell2", (f"tcp/127.0.0.1:{cell.port}",)), None)
        with pytest.raises(ListenError, match=rf"zenoh: .*{cell.port}.*Address already in use"):
            await rival.start()
        await rival.close()
    await until(lambda: python_threads() <= before)


@pytest.mark.parametrize("endpoint", ["nonsense", "tcp/127.0.0.1:99999x", "carrier-pigeon/roof:1"])
async def test_an_endpoint_that_cannot_be_is_refused(endpoint):
    """A mistyped endpoint is an error that shows it."""
    publisher = ZenohPublisher(ZenohSettings("cell1", (endpoint,)), None)
    with pytest.raises((ConfigError, ListenError), match=endpoint.split("/")[0]):
        try:
            await publisher.start()
        finally:
            await publisher.close()


@pytest.mark.parametrize("content", [None, "{", "{ mode: 'peer', lisen: 3 }"])
def test_a_zenoh_file_with_a_mistake_is_a_config_error(tmp_path, content):
    """A file that is missing, broken or has an unknown key is named in the error."""
    file = tmp_path / "zenoh.json5"
    if content is not None:
        file.write_text(content)
    publisher = ZenohPublisher(ZenohSettings("cell1", config_file=file), None)
    with pytest.raises(ConfigError, match=r"zenoh\.json5"):
        asyncio.run(publisher.start())


async def test_what_zenohs_own_file_says_wins(tmp_path):
    """Endpoints of Zenoh's own file replace those of the cell's configuration."""
    port = free_port()
    file = tmp_path / "zenoh.json5"
    file.write_text(json.dumps({"listen": {"endpoints": [f"tcp/127.0.0.1:{port}"]}}))
    async with Cell(config_file=file) as cell:
        with socket.socket() as probe:
            assert 0 != probe.connect_ex(("127.0.0.1", cell.port)), "the other endpoint is not opened"
        (reply,) = await ask(port, "edged/cell1/jobs")
    assert reply["ok"]


@pytest.mark.long
async def test_results_come_back_when_the_router_does(caplog):
    """Cell and subscriber find a router that dies and returns, without a restart.

    The cell's log says when it disappears and when it is connected.
    """
    caplog.set_level(logging.INFO)
    port = free_port()
    endpoint = f"tcp/127.0.0.1:{port}"
    expected: list[str] = []

    def told() -> list[str]:
        lines = [line for line in caplog.messages if "the router" in line]
        return ["gone" if "is gone" in line else "connected" for line in lines]

    async with Cell(listen=(), connect=(endpoint,)) as cell:
        with listener(port) as other:
            for cycle in (1, 2):
                with peer("router", mode="router", listen__endpoints=[endpoint]) as router:
                    heard = asyncio.create_task(other.until(is_message("target", cycle=cycle)))
                    while not heard.done():
                        cell.publisher.announce(make_snapshot(cycle))
                        await asyncio.wait({heard}, timeout=0.1)
                    await heard
                    expected.append("connected")
                    await until(lambda: told() == expected)
                    router.close(kill=True)
                    expected.append("gone")
                    await until(lambda: told() == expected)


def test_a_router_that_is_not_there_is_said_once(caplog):
    """A missing router is logged once, after enough time to connect, and not if none is configured."""
    for endpoints in (["tcp/192.0.2.1:7447"], []):
        watched = Routers(endpoints)
        for _ in range(3 * PATIENCE):
            watched.look(())
    (line,) = caplog.messages
    assert "no router answers at tcp/192.0.2.1:7447" in line


async def test_strangers_do_not_take_every_descriptor(monkeypatch):
    """Sessions beyond the limit are refused, and a silent connection is closed."""
    monkeypatch.setattr(session, "MAX_SESSIONS", 2)
    monkeypatch.setattr(session, "ACCEPT_TIMEOUT_MS", 300)
    async with Cell() as cell:
        reader, writer = await asyncio.open_connection("127.0.0.1", cell.port)
        async with asyncio.timeout(LIMIT_S):
            with contextlib.suppress(ConnectionError):
                assert b"" == await reader.read()
        writer.close()
        strangers = session_config("client", [], [f"tcp/127.0.0.1:{cell.port}"])
        opened = [await asyncio.to_thread(zenoh.open, strangers) for _ in range(2)]
        with pytest.raises(zenoh.ZError):
            await asyncio.to_thread(zenoh.open, strangers)
        for one in opened:
            await asyncio.to_thread(one.close)


async def test_ros2_nodes_get_good_poses_and_see_the_publisher(monkeypatch):
    """Both topics have the same sequence with an attachment of 33 bytes; faults have no pose."""
    monkeypatch.setattr(ros2, "_xxh3_128", lambda _data: bytes(range(16)))
    samples: queue.Queue[zenoh.Sample] = queue.Queue()
    async with Cell(ros2_domain_id=5) as cell:
        with open_session(session_config("peer", [], [f"tcp/127.0.0.1:{cell.port}"])) as other:
            other.declare_subscriber("5/edged/cell1/**", samples.put)
            other.liveliness().declare_subscriber("@ros2_lv/5/**", samples.put, history=True)
            tokens = [await asyncio.to_thread(samples.get, timeout=LIMIT_S) for _ in range(3)]
            cell.publisher.announce(make_snapshot(1, Status.CAPTURE_FAULT))
            cell.publisher.announce(make_snapshot(2))
            pose, twin = [await asyncio.to_thread(samples.get, timeout=LIMIT_S) for _ in range(2)]
    assert ["MP", "MP", "NN"] == sorted(str(token.key_expr).split("/")[5] for token in tokens)
    assert [ros2.POSE.name, ros2.POSE_WITH_COVARIANCE.name] == [
        str(s.key_expr).split("/")[4] for s in (pose, twin)
    ]
    assert [33, 33] == [len(sample.attachment) for sample in (pose, twin)]
    expected = ros2.pose_of(make_snapshot(2), "cell1")
    assert ros2.encode_pose(expected) == pose.payload.to_bytes()
    assert ros2.encode_pose_with_covariance(expected) == twin.payload.to_bytes()


async def test_previews_are_sent_only_while_somebody_looks(monkeypatch):
    """Only the subscribed side is encoded and sent, as a JPEG of its exposure."""
    samples: queue.Queue[zenoh.Sample] = queue.Queue()
    image = np.tile(np.arange(0, 256, dtype=np.uint8), (960, 5))
    left = Frame("left", 17, image, 0, 1_700_000_000_000_000_000)
    right = dataclasses.replace(left, camera="right", image=np.zeros_like(image))
    encoded: list[bool] = []
    monkeypatch.setattr(
        preview,
        "jpeg",
        lambda pixels, *size, jpeg=preview.jpeg: encoded.append(pixels.any()) or jpeg(pixels, *size),
    )
    exposure = ExposureDone(4, None, FramePair(left, right))
    async with Cell() as cell:
        cell.publisher.announce(exposure)  # without a subscriber
        with open_session(session_config("peer", [], [f"tcp/127.0.0.1:{cell.port}"])) as other:
            other.declare_subscriber("edged/cell1/preview/left", samples.put)
            deadline_s = time.monotonic() + LIMIT_S
            while samples.empty() and time.monotonic() < deadline_s:
                cell.publisher.announce(exposure)
                await asyncio.sleep(0.02)
            sample = samples.get_nowait()
    assert all(encoded), "the right image is black"
    picture = cv2.imdecode(np.frombuffer(sample.payload.to_bytes(), np.uint8), cv2.IMREAD_UNCHANGED)
    assert (480, 640) == picture.shape
    np.testing.assert_allclose(picture[240, ::64], image[480, ::128], atol=6)
    caption = json.loads(sample.attachment.to_bytes())
    assert (4, 17, 1_700_000_000_000_000_000) == tuple(
        caption[k] for k in ("cycle", "frame_id", "exposed_ns")
    )


def test_a_full_outbox_loses_its_oldest_job():
    """Jobs queued behind a stalled send are replaced by newer ones, counted, and run in order."""
    worker, gate, done = JobThread("test", 3), threading.Event(), []
    started = threading.Event()

    def stall() -> None:
        started.set()
        gate.wait(LIMIT_S)

    worker.start()
    worker.post(stall)
    assert started.wait(LIMIT_S)
    for number in range(10):
        worker.post(lambda number=number: done.append(number))
    gate.set()
    worker.stop(LIMIT_S)
    assert [7, 8, 9] == done
    assert 7 == worker.dropped


def test_a_job_that_fails_does_not_end_the_worker(caplog):
    """A failing job is logged with its traceback and counted, and the next one runs."""
    worker, done = JobThread("test", 3), []
    worker.post(lambda: 1 / 0)
    worker.post(lambda: done.append(True))
    worker.start()
    worker.stop(LIMIT_S)
    assert ([True], 1) == (done, worker.failed)
    assert "ZeroDivisionError" in caplog.text
