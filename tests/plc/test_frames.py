"""Binary frames of robots: only complete frames of the right request are accepted."""

from __future__ import annotations

import dataclasses
import re
import zlib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edged.plc.frames import (
    ANSWER,
    ANSWER_ROWS,
    BRANDS,
    COMMANDS,
    REQUEST,
    REQUEST_ROWS,
    FrameRequest,
    answer_frame,
    read_answer,
    read_request,
)
from edged.plc.lines import POSE_NAMES, LineAnswer, LineStatus
from edged.robot.orientations import Brand

FLOAT = st.floats(width=32, allow_nan=False, allow_infinity=False)
WORD = st.integers(0, 0xFFFF)
PAGE = Path(__file__).parents[2] / "docs/how-to/plc.md"


@pytest.mark.slow
@given(WORD, st.sampled_from(sorted(COMMANDS)), WORD, st.booleans(), st.booleans(), st.data())
@settings(max_examples=100, derandomize=True)
def test_a_request_is_read_as_it_was_written(
    sequence: int, command: str, job: int, tries_all: bool, is_flange: bool, data: st.DataObject
) -> None:
    """Requests survive encoding and decoding for every brand, with a flange or without."""
    for brand in Brand:
        size = len(POSE_NAMES[brand])
        flange = tuple(data.draw(st.lists(FLOAT, min_size=size, max_size=size))) if is_flange else ()
        asked = FrameRequest(sequence, command, job, flange, tries_all)
        assert 44 == len(asked.frame())
        assert asked == read_request(asked.frame(), brand)
        named = dataclasses.replace(asked, brand=brand)
        for configured in Brand:
            assert named == read_request(named.frame(), configured)


@pytest.mark.long
@given(WORD, st.sampled_from(LineStatus), WORD, st.data())
@settings(max_examples=100, derandomize=True)
def test_an_answer_is_read_as_it_was_written(
    sequence: int, status: LineStatus, remaining: int, data: st.DataObject
) -> None:
    """Answers of 60 bytes survive encoding and decoding, and are refused for another request or brand."""
    for brand in Brand:
        size = len(POSE_NAMES[brand])
        numbers = tuple(data.draw(st.lists(FLOAT, min_size=size + 4, max_size=size + 4)))
        x, y, z, age_s = numbers[size:]
        answer = LineAnswer(sequence, status, remaining, numbers[:size], (x, y, z), age_s)
        frame = answer_frame(answer, brand)
        assert 60 == len(frame)
        assert answer == read_answer(frame, brand, sequence)
        if sequence:
            with pytest.raises(ValueError, match="an answer to"):
                read_answer(frame, brand, sequence ^ 1)
        for other in set(Brand) - {brand}:
            with pytest.raises(ValueError, match="brand"):
                read_answer(frame, other, sequence)


def test_a_frame_that_is_changed_anywhere_is_none() -> None:
    """A frame with a bit changed, bytes missing or added, or shifted is refused."""
    request, answer = FrameRequest(7, "LOCATE", 2).frame(), answer_frame(LineAnswer(7, 0, 1), Brand.KUKA)
    for frame in (request, answer):
        wrong = [frame[:size] for size in range(len(frame))] + [frame + b"\0"]
        wrong += [(frame + frame)[shift : shift + len(frame)] for shift in range(1, len(frame))]
        for bit in range(8 * len(frame)):
            turned = bytearray(frame)
            turned[bit // 8] ^= 1 << bit % 8
            wrong.append(bytes(turned))
        for one in wrong:
            with pytest.raises(ValueError):
                read_request(one, Brand.KUKA)
            with pytest.raises(ValueError):
                read_answer(one, Brand.KUKA, 7)


@pytest.mark.slow
@given(st.binary(min_size=REQUEST.size - 4, max_size=REQUEST.size - 4), st.booleans())
@settings(max_examples=500, derandomize=True)
def test_whatever_comes_is_a_request_or_none(body: bytes, is_headed: bool) -> None:
    """Any bytes are a request that encodes to the same frame, or a ValueError."""
    head = FrameRequest(1, "LOCATE").frame()[:6] if is_headed else b""
    sealed = head + body[len(head) :]
    frame = sealed + zlib.crc32(sealed).to_bytes(4, "big")
    for one in (frame, body + b"\0\0\0\0"):
        try:
            asked = read_request(one, Brand.ABB)
        except ValueError:
            continue
        assert one == frame and asked.command in COMMANDS


def test_an_answer_with_a_number_that_is_none_is_none() -> None:
    """An infinite or NaN number in an intact frame is refused."""
    for number in (float("inf"), float("nan")):
        frame = answer_frame(LineAnswer(7, 0, 0, (number,) * 6), Brand.KUKA)
        with pytest.raises(ValueError, match="not finite"):
            read_answer(frame, Brand.KUKA, 7)


def test_a_refusal_of_what_was_no_request_is_heard() -> None:
    """An answer with sequence 0 is accepted if it has an error status, but not with status 0."""
    refused = LineAnswer(0, LineStatus.NOT_UNDERSTOOD)
    assert LineStatus.NOT_UNDERSTOOD == read_answer(answer_frame(refused, Brand.UR), Brand.UR, 7).status
    with pytest.raises(ValueError, match="an answer to 0"):
        read_answer(answer_frame(LineAnswer(0, LineStatus.OK), Brand.UR), Brand.UR, 7)


def test_the_page_says_where_everything_stands() -> None:
    """The manual states offset, name and type of each field, and the numbers of commands and brands."""
    text = PAGE.read_text()
    names = {"2s": "2 bytes", "B": "u8", "H": "u16", "I": "u32", "f": "f32", "3f": "3 f32", "7f": "7 f32"}
    for rows, form in ((REQUEST_ROWS, REQUEST), (ANSWER_ROWS, ANSWER)):
        at, expected = 0, []
        for name, kind in rows:
            expected.append(f"| {at} | {name} | {names[kind]} |")
            at += {"2s": 2, "B": 1, "H": 2, "I": 4, "f": 4, "3f": 12, "7f": 28}[kind]
        assert at == form.size
        missing = [one for one in expected if one not in text]
        assert [] == missing
    numbers = {**COMMANDS, **{str(brand): number for brand, number in BRANDS.items()}}
    assert [] == [f"{n} {name}" for name, n in numbers.items() if not re.search(rf"\b{n} {name}\b", text)]
