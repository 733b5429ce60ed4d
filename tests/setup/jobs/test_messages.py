"""Messages between the page and its worker: values of a closed list of types, never code."""

from __future__ import annotations

import dataclasses
import math
import random
import time
import tracemalloc
import typing
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import cbor2
import numpy as np
import pytest
from helpers.fieldtypes import reachable
from helpers.mutations import mutated
from helpers.snapshots import make_snapshot
from pydantic import JsonValue

from edged.codec.codec import FORMAT, Codec
from edged.codec.fieldkinds import check_of, checks_of
from edged.domain.arrays import FloatArray
from edged.domain.measurement import Status
from edged.errors import CalibrationError, ConfigError
from edged.files.recording import Entry
from edged.link.values import CODEC as LINK
from edged.robot.orientations import Brand
from edged.setup.calibration import service as calibration
from edged.setup.jobs import workerprocess
from edged.setup.jobs.messages import CODEC, decode_message, encode_message
from edged.setup.jobs.workerprocess import TaskProgress, TaskRefused, TaskResult
from edged.setup.recordings import regressions
from edged.setup.recordings import service as recordings
from edged.setup.registration import service as registration
from edged.setup.teaching import service as teaching
from edged.setup.trials import service as trials
from edged.sim.cell import demo_rig
from edged.vision.geometry.camera import calibration_identity

SERVICES = (calibration, registration, teaching, trials, recordings, regressions)
NOT_DECLARED = {Brand, Status}
"""In fields of any type: a reading's robot, and the status of a cycle tried again."""


def test_the_list_has_what_the_tasks_take_and_give_and_no_more() -> None:
    """It equals the types in the annotations of all functions that the worker offers."""
    found: set[type] = set()
    reachable(workerprocess.TaskOrder, found)
    reachable(workerprocess.TaskAnswer, found)
    for service in SERVICES:
        for place in service.FUNCTIONS.values():
            module, _, name = place.partition(":")
            for hint in typing.get_type_hints(getattr(import_module(module), name)).values():
                reachable(hint, found)
    listed = {(str(module), name) for name, module in CODEC.kinds.items()}
    assert {(kind.__module__, kind.__name__) for kind in found | NOT_DECLARED} == listed


def test_an_answer_comes_back_as_it_was() -> None:
    """Results are identical after encoding and decoding, down to the bits."""
    rig = demo_rig()
    found = {
        "rig": rig,
        (1, "a"): [Status.OK, np.float32(0.1), math.inf, -0.0, 2**60, b"\x00", Path("/a"), frozenset({1})],
        "arrays": (np.arange(6.0).reshape(2, 3).T, np.zeros((0, 3), np.uint8), np.array(True), np.array("a")),
    }
    again = decode_message(encode_message(found))
    assert found.keys() == again.keys()
    assert found[1, "a"] == again[1, "a"]
    assert [type(one) for one in found[1, "a"]] == [type(one) for one in again[1, "a"]]
    for before, after in zip(found["arrays"], again["arrays"], strict=True):
        np.testing.assert_array_equal(before, after, strict=True)
        assert after.flags.writeable
    assert calibration_identity(rig.left, rig.right, rig.right_from_left) == calibration_identity(
        again["rig"].left, again["rig"].right, again["rig"].right_from_left
    )


def test_errors_times_and_names_that_are_no_text_come_back() -> None:
    """Errors with their fields, times, and file names that are not UTF-8 are restored."""
    error = CalibrationError("no views", "few", seen=2)
    told = decode_message(encode_message(TaskRefused(error))).error
    assert (CalibrationError, "no views", "few", {"seen": 2}) == (
        type(told),
        str(told),
        told.code,
        told.params,
    )
    config = decode_message(encode_message(TaskRefused(ConfigError("cell.toml", ["a: b"])))).error
    assert (ConfigError, ["a: b"]) == (type(config), config.problems)
    entry = Entry(Path("/tmp/\udcff.npz"), 1, datetime(2026, 1, 2, tzinfo=UTC), "OK", "f00d")
    assert entry == decode_message(encode_message(entry))
    assert "half ? a pair" == decode_message(encode_message("half \ud800 a pair"))


@pytest.mark.parametrize(
    "value", [object(), print, Path.open, np.array([{}], object), [1, {"a": {1, 2}}], 2**70, Status]
)
def test_what_is_no_value_is_not_written(value: object) -> None:
    """The sender gets an error that names the type."""
    for codec in (CODEC, LINK):
        with pytest.raises((TypeError, ValueError), match=r"is no message|64 bits"):
            codec.encode(value)


def test_a_kind_that_is_not_on_the_list_is_refused_by_name_on_both_sides() -> None:
    """Neither end encodes or decodes types of the other direction, and the error names the type."""
    for writes, reads, value in ((LINK, CODEC, make_snapshot()), (CODEC, LINK, TaskProgress("a", 1, 2))):
        name = type(value).__name__
        with pytest.raises(TypeError, match=name):
            reads.encode(value)
        with pytest.raises(ValueError, match=f"{name} is not on the list"):
            reads.decode(writes.encode(value))


def hostile() -> dict[str, bytes]:
    """Messages that a compromised process might send, by the expected error."""
    error = ["error", "UserError", "a", {"code": "", "params": "ab"}]
    values: dict[str, object] = {
        "make_folders is not on the list": ["make_folders", "/tmp/x"],
        "Worker is not on the list": ["Worker", {}],
        "TaskProgress has other fields": ["TaskProgress", {"stage": "a"}],
        "TaskProgress.stage is of another kind": ["TaskProgress", {"stage": 1, "done": 1, "total": 1}],
        "TaskProgress.done is of another kind": ["TaskProgress", {"stage": "a", "done": True, "total": 1}],
        "SigmaXyz has no more": ["SigmaXyz", {"more": 1}],
        "no error": ["TaskRefused", {"error": ["error", "printable", 1, {}]}],
        "its params": ["TaskRefused", {"error": error}],
        "TaskRefused.error is of another kind": ["TaskRefused", {"error": None}],
        "an array of |O": ["array", "|O", [1], bytes(8)],
        "reshape": ["array", "<f8", [2**40, 2**40], bytes(8)],
        "array does not have 4 parts": ["array", "<f8", [], b"", 1],
        "not begin with what it is": [1],
        "tag 35": cbor2.CBORTag(35, "(a+)+$"),
        "no value": cbor2.undefined,
        "no text": {1: 2},
        "unhashable": ["set", ["list"]],
    }
    told = {why: cbor2.dumps([FORMAT, value]) for why, value in values.items()}
    return {
        **told,
        "cut off": b"",
        "tag 28": bytes.fromhex("d81c81d81d00"),
        "100 deep": b"\x81" * 100_000 + b"\x00",
        "more than 1000 items": b"\x99\x40\x00" + b"\x80" * (1 << 14),
        "in 3 bytes": b"\x9b\x7f" + b"\xff" * 7 + b"\x80" * 3,
        "bytes behind": cbor2.dumps([FORMAT, 1]) + b"\x00",
        "of the format": cbor2.dumps([FORMAT + 1, 1]),
        "not definite": b"\x9f\xff",
    }


@pytest.mark.parametrize("why", hostile())
def test_anything_else_is_refused_and_says_why(why: str) -> None:
    """Each is refused with its reason, before it uses much memory."""
    data = hostile()[why]
    codec = dataclasses.replace(CODEC, bounds=dataclasses.replace(CODEC.bounds, items=1000))
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=f"no message of a worker: .*{why.replace('|', '.')}"):
            codec.decode(data)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


def test_random_and_mutated_messages_are_a_value_of_the_list_or_an_error_that_says_why() -> None:
    """Random and mutated messages give a listed value that encodes again, or an error with a reason."""
    chance = random.Random(7)
    written = [
        (CODEC, encode_message(TaskResult({"rig": demo_rig(), "at": (1, 2.0, None)}))),
        (CODEC, encode_message(TaskProgress("looks at pair 3", 3, 20))),
        (CODEC, encode_message(TaskRefused(CalibrationError("no views", "few", seen=2)))),
        (LINK, LINK.encode(make_snapshot())),
    ]
    refused = made = 0
    began_s = time.process_time()
    for number in range(4000):
        codec, message = written[number % len(written)]
        data = mutated(message, chance) if number % 8 else chance.randbytes(chance.randint(0, 200))
        try:
            value = codec.decode(data)
        except ValueError as error:
            assert str(error).startswith("no message of")
            refused += 1
            continue
        codec.encode(value)
        made += 1
    assert refused > 1000
    assert made > 100
    assert time.process_time() - began_s < 60


@pytest.mark.parametrize("codec", [CODEC, LINK], ids=["worker", "link"])
def test_the_fields_of_every_kind_can_be_checked(codec: Codec) -> None:
    """Every field of every listed type has a check, and none accepts an invalid value."""
    for name, listed in codec.kinds.items():
        kind = getattr(import_module(listed), name) if isinstance(listed, str) else listed
        if dataclasses.is_dataclass(kind):
            assert checks_of(kind).keys() == {field.name for field in dataclasses.fields(kind)}


@pytest.mark.parametrize(
    ("hint", "right", "wrong"),
    [
        (bool, [True, np.True_], [1, None]),
        (int, [1, np.int32(1)], [True, 1.0, "1"]),
        (float, [1, 1.0, np.float32(1)], [True, "1", None]),
        (str | None, ["a", None], [b"a", 1]),
        (Literal["left", 1], ["left", 1], ["up", 1.0, True]),
        (tuple[int, str], [(1, "a")], [(1,), ("a", 1), [1, "a"]]),
        (tuple[int, ...], [(), (1, 2), [1]], [(1, "a"), 1]),
        (Sequence[str], [["a"], ()], ["a", [1]]),
        (Mapping[str, int], [{"a": 1}, {}], [{1: 1}, {"a": "b"}, []]),
        (frozenset[int], [frozenset({1})], [{1}, frozenset({"a"})]),
        (JsonValue, [{"a": [1, None]}, 1.5, True], [(1,), {1: 2}, [b"a"]]),
        (FloatArray, [np.zeros(2)], [np.zeros(2, np.int32), [0.0], None]),
        (Status, [Status.OK], ["OK", 1]),
    ],
    ids=str,
)
def test_a_field_takes_what_it_is_declared_with(hint: Any, right: list[Any], wrong: list[Any]) -> None:
    """Each check accepts the right values and rejects similar ones."""
    check = check_of(hint)
    assert [True] * len(right) == [check(value) for value in right]
    assert [False] * len(wrong) == [check(value) for value in wrong]
