"""The stereo head: each capture is one exposure or one fault, in bounded time, with nothing left running."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pytest
from helpers.waiting import LIMIT_S

from edged import errors
from edged.cell.stereohead import REOPEN_AFTER, HeadSettings, StereoHead
from edged.cell.tasks import both
from edged.domain.arrays import Image
from edged.domain.frames import Frame, FramePair
from edged.errors import (
    CameraBusy,
    CameraSetupError,
    CameraUnreachable,
    CaptureError,
    FrameFrozen,
    FrameIncomplete,
    FrameRepeated,
    FrameTimeout,
    PairingError,
    StreamStalled,
)
from edged.sim.exposure import ExposureRequest
from edged.sim.inprocess import InProcessCamera, InProcessFaults

TIMEOUT_S = 0.2
"""For a silent camera; others may take as long as a busy machine needs."""


def noise(request: ExposureRequest) -> Image:
    """An image that differs with every exposure."""
    return np.random.default_rng(request.frame_id).integers(
        0, 256, (request.height, request.width), dtype=np.uint8
    )


class Bench:
    """A stereo head on two in-process cameras."""

    def __init__(
        self,
        exposure: Callable[[ExposureRequest], Image] = noise,
        clock: Callable[[], float] = time.monotonic,
        **options: Any,
    ) -> None:
        self.left, self.right = (
            InProcessCamera(name, exposure, width=16, height=12) for name in ("left", "right")
        )
        self.head = StereoHead(
            self.left,
            self.right,
            HeadSettings(**{"timeout_s": LIMIT_S, "max_skew_s": 0.1, "min_backoff_s": 0.02, **options}),
            clock,
        )

    def side(self, name: str) -> InProcessCamera:
        return self.left if name == "left" else self.right

    async def is_closed(self, name: str) -> None:
        """Wait until the camera is closed in the background."""
        deadline_s = time.monotonic() + 3.0
        while self.side(name).is_open:
            assert time.monotonic() < deadline_s, "was not closed"
            await asyncio.sleep(0.001)

    async def recovers(self, within_s: float = 3.0) -> FramePair:
        """First good pair; any error on the way must be a `CaptureError`."""
        deadline_s = time.monotonic() + within_s
        while True:
            try:
                return await self.head.capture()
            except CaptureError:
                assert time.monotonic() < deadline_s, "did not recover"
                await asyncio.sleep(0.01)


@asynccontextmanager
async def used(bench: Bench | None = None) -> AsyncIterator[Bench]:
    """A bench that is closed afterwards; no task may survive."""
    bench = bench or Bench()
    before = asyncio.all_tasks()
    try:
        yield bench
    finally:
        await bench.head.close()
        assert before == asyncio.all_tasks(), "a task was left behind"
        assert not bench.left.is_open
        assert not bench.right.is_open


SIDES = pytest.mark.parametrize("name", ["left", "right"])


# --- both ---------------------------------------------------------------------------------------


async def test_both_returns_both_results_in_order() -> None:
    """Results keep their order, whichever finishes first."""

    async def give(value: int, delay_s: float) -> int:
        await asyncio.sleep(delay_s)
        return value

    assert (1, 2) == await both(give(1, 0.01), give(2, 0.0), 1.0)


@pytest.mark.parametrize("failing", [0, 1])
@pytest.mark.parametrize("how", ["error", "timeout", "cancelled"])
async def test_both_leaves_nothing_running(failing: int, how: str) -> None:
    """After an error, time-out or cancellation both coroutines have ended, including their clean-up."""
    ended: list[int] = []

    async def work(number: int) -> None:
        try:
            if how == "error" and number == failing:
                raise FrameTimeout("left", "gone")
            await asyncio.sleep(30)
        finally:
            await asyncio.sleep(0.01)  # a slow clean-up is waited for
            ended.append(number)

    expected = {"error": FrameTimeout, "timeout": TimeoutError, "cancelled": asyncio.CancelledError}[how]
    task = asyncio.create_task(both(work(0), work(1), 0.02 if how == "timeout" else 10.0))
    await asyncio.sleep(0)
    if how == "cancelled":
        await asyncio.sleep(0.01)
        task.cancel()
    with pytest.raises(expected):
        await task
    assert {0, 1} == set(ended)
    assert asyncio.all_tasks() == {asyncio.current_task()}


async def test_both_awaits_the_other_even_when_cancelled_twice() -> None:
    """A second cancellation does not shorten the clean-up, and is not lost."""
    ended: list[int] = []

    async def work(number: int) -> None:
        try:
            await asyncio.sleep(30)
        finally:
            await asyncio.shield(asyncio.sleep(0.05))
            ended.append(number)

    task = asyncio.create_task(both(work(0), work(1), 10.0))
    await asyncio.sleep(0.01)
    task.cancel()
    await asyncio.sleep(0.01)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert [0, 1] == sorted(ended)


# --- good pairs -----------------------------------------------------------------------------------


async def test_a_capture_opens_the_cameras_and_gives_what_they_saw() -> None:
    """Images arrive byte for byte, with increasing ids, within the skew limit."""
    async with used() as bench:
        pairs = [await bench.head.capture() for _ in range(5)]

    assert [1, 2, 3, 4, 5] == [pair.left.frame_id for pair in pairs] == [p.right.frame_id for p in pairs]
    for pair in pairs:
        expected = noise(ExposureRequest(pair.left.frame_id, 0, 0, 0.0, 0.0, 16, 12))
        np.testing.assert_array_equal(expected, pair.left.image)
        assert abs(pair.left.exposed_ns - pair.right.exposed_ns) < 5e6


async def test_both_cameras_expose_at_the_same_time() -> None:
    """Both exposures run at the same time: they meet at a barrier."""
    barrier = threading.Barrier(2)

    def meet(request: ExposureRequest) -> Image:
        barrier.wait(LIMIT_S)
        return noise(request)

    async with used(Bench(meet, timeout_s=10.0)) as bench:
        await bench.head.capture()


async def test_the_loop_keeps_running_while_an_image_is_rendered() -> None:
    """The event loop runs while an image is rendered."""
    async with used():
        loop = asyncio.get_running_loop()

        def render(request: ExposureRequest) -> Image:
            turned = threading.Event()
            loop.call_soon_threadsafe(turned.set)
            assert turned.wait(LIMIT_S), "the event loop stood still"
            return noise(request)

        left, right = (InProcessCamera(name, render, width=16, height=12) for name in ("left", "right"))
        head = StereoHead(left, right, HeadSettings(timeout_s=10.0))
        await head.capture()
        await head.close()


async def test_a_frame_is_not_a_view_of_the_renderers_memory() -> None:
    """A later exposure does not change an image already returned."""
    shared = np.zeros((12, 16), np.uint8)

    def render(request: ExposureRequest) -> Image:
        shared[:] = request.frame_id
        shared[0, 0] = 255
        return shared

    async with used(Bench(render)) as bench:
        first, second = await bench.head.capture(), await bench.head.capture()
    assert (1, 2) == (first.left.image[5, 5], second.left.image[5, 5])


# --- faults ---------------------------------------------------------------------------------------


@SIDES
@pytest.mark.parametrize("kind", [FrameTimeout, FrameIncomplete, PairingError])
async def test_a_single_lost_exposure_does_not_close_a_camera(name: str, kind: type[CaptureError]) -> None:
    """After one lost frame the next capture works at once on the same connection."""
    async with used() as bench:
        await bench.head.capture()
        bench.side(name).faults.fail_next_trigger = kind(name, "once")
        with pytest.raises(kind, match="once"):
            await bench.head.capture()
        await bench.head.capture()
        assert (1, 1) == (bench.left.opened, bench.right.opened)


@SIDES
@pytest.mark.parametrize("kind", [CameraUnreachable, CameraBusy, CameraSetupError])
async def test_a_camera_that_is_gone_is_closed_and_opened_again(name: str, kind: type[CaptureError]) -> None:
    """Only the broken camera is reopened; the other keeps its connection."""
    other = "right" if name == "left" else "left"
    async with used() as bench:
        await bench.head.capture()
        bench.side(name).faults.fail_next_trigger = kind(name, "gone")
        with pytest.raises(kind):
            await bench.head.capture()
        await bench.is_closed(name)
        assert bench.side(other).is_open
        pair = await bench.recovers()
        assert (2, 1) == (bench.side(name).opened, bench.side(other).opened)
        assert pair.left.exposed_ns > 0


@SIDES
async def test_a_camera_that_never_delivers_is_named_in_time_and_reopened(name: str) -> None:
    """Each capture ends at the time-out and names the silent camera, which is reopened after three."""
    async with used(Bench(timeout_s=TIMEOUT_S)) as bench:
        await bench.head.capture()
        faults = bench.side(name).faults
        faults.stall = True
        for _ in range(REOPEN_AFTER):
            started_s = time.monotonic()
            with pytest.raises(FrameTimeout) as caught:
                await bench.head.capture()
            assert name == caught.value.camera
            assert time.monotonic() - started_s < 20 * TIMEOUT_S
        await bench.is_closed(name)
        faults.stall = False
        await bench.recovers()
        assert 2 == bench.side(name).opened


async def test_two_silent_cameras_are_both_named() -> None:
    """If both cameras are silent, the error names both."""
    async with used(Bench(timeout_s=TIMEOUT_S)) as bench:
        bench.left.faults.stall = bench.right.faults.stall = True
        with pytest.raises(FrameTimeout) as caught:
            await bench.head.capture()
        assert "both" == caught.value.camera


async def test_one_failing_camera_does_not_keep_the_other_waiting() -> None:
    """The error is raised when it occurs, without waiting for the other camera."""
    async with used(Bench(timeout_s=60.0)) as bench:
        bench.left.faults.stall = True
        bench.right.faults.fail_next_trigger = FrameIncomplete("right", "packets missing")
        with pytest.raises(FrameIncomplete):
            await asyncio.wait_for(bench.head.capture(), LIMIT_S)


@SIDES
async def test_a_late_image_is_never_taken_for_the_next_exposure(name: str) -> None:
    """An image that missed its deadline is dropped, and the next pair is from one trigger."""
    async with used(Bench(timeout_s=TIMEOUT_S)) as bench:
        await bench.head.capture()
        bench.side(name).faults.delay_s = 2 * TIMEOUT_S
        with pytest.raises(FrameTimeout):
            await bench.head.capture()
        bench.side(name).faults.delay_s = 0.0
        pair = await bench.head.capture()
        np.testing.assert_array_equal(*pair.images)
        assert pair.left.frame_id == pair.right.frame_id == 3


# --- pairing --------------------------------------------------------------------------------------


@SIDES
async def test_exposures_that_are_apart_are_no_pair(name: str) -> None:
    """Beyond the limit the error states the skew; within it there is a pair."""
    async with used(Bench(max_skew_s=0.05, timeout_s=10.0)) as bench:
        await bench.head.capture()
        bench.side(name).faults.skew_s = 0.2
        with pytest.raises(PairingError, match=r"exposures (199|2\d\d)\.\d+ ms apart, allowed 50 ms"):
            await bench.head.capture()
        bench.side(name).faults.skew_s = 0.0
        await bench.head.capture()


class Scripted:
    """A camera whose frames have the ids and times the test wants."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.opened = 0
        self.frame_id = 0
        self.device_ns = 0
        self.exposed_ns = 10**18
        self.level = 0

    async def open(self) -> None:
        self.opened += 1

    async def trigger(self) -> None:
        self.level = (self.level + 1) % 200

    async def frame(self) -> Frame:
        image = np.zeros((4, 4), np.uint8)
        image[0, 0] = 1 + self.level
        return Frame(self.name, self.frame_id, image, self.device_ns, self.exposed_ns)

    async def close(self) -> None:
        pass

    def expose(self, frame_id: int, device_s: float) -> None:
        self.frame_id, self.device_ns = frame_id, round(device_s * 1e9)


def scripted(*exposures: tuple[tuple[int, float], tuple[int, float]]) -> list[str]:
    """Result for each (frame id, device time) of left and right: "" or the fault."""
    left, right = Scripted("left"), Scripted("right")

    async def main() -> list[str]:
        head = StereoHead(left, right, HeadSettings(timeout_s=5.0, max_skew_s=0.005))
        verdicts = []
        for ours, theirs in exposures:
            left.expose(*ours)
            right.expose(*theirs)
            try:
                await head.capture()
                verdicts.append("")
            except PairingError as error:
                verdicts.append(str(error))
        await head.close()
        return verdicts

    return asyncio.run(main())


def test_the_cameras_own_clocks_must_agree_on_the_time_between_two_pairs() -> None:
    """A trigger taken 20 ms late by one camera is found by the device clocks, whatever their epochs."""
    good, late, healed = scripted(
        ((1, 100.0), (1, 7000.0)), ((2, 101.0), (2, 7001.02)), ((3, 102.0), (3, 7002.0))
    )

    assert ("", "") == (good, healed)
    assert "exposures by the cameras' own clocks 20.00 ms apart" in late


def test_clock_drift_over_a_long_pause_is_no_skew() -> None:
    """A clock difference of 300 ppm over an hour is no skew."""
    assert ["", ""] == scripted(((1, 0.0), (1, 0.0)), ((2, 3600.0), (2, 3601.08)))


def test_cameras_without_a_clock_are_paired_all_the_same() -> None:
    """Constant device times are ignored."""
    assert ["", "", ""] == scripted(((1, 0.0), (1, 5.0)), ((2, 0.0), (2, 6.0)), ((3, 0.0), (3, 7.0)))


@pytest.mark.parametrize("ids", [(5, 5), (5, 4)])
def test_a_frame_that_was_there_before_is_a_fault(ids: tuple[int, int]) -> None:
    """Equal or decreasing frame ids are a fault that states both numbers."""
    first, second = scripted(((ids[0], 1.0), (1, 1.0)), ((ids[1], 2.0), (2, 2.0)))

    assert "" == first
    assert f"camera left: frame {ids[1]} came after frame {ids[0]}" in second


@SIDES
async def test_a_frozen_image_is_never_published_not_even_after_reopening(name: str) -> None:
    """A repeated image under a new id is a fault each time, also after reopening, until it changes."""
    async with used() as bench:
        await bench.head.capture()
        bench.side(name).faults.frozen = True
        deadline_s = time.monotonic() + 0.5
        reasons = set()
        while time.monotonic() < deadline_s:
            with pytest.raises(PairingError) as caught:
                await bench.head.capture()
            reasons.add(caught.value.camera)
            await asyncio.sleep(0.01)
        assert bench.side(name).opened > 1
        assert {name} == reasons
        bench.side(name).faults.frozen = False
        await bench.recovers()


@SIDES
async def test_an_image_of_another_size_than_the_rigs_is_a_fault_of_that_camera(name: str) -> None:
    """The error states both sizes, and the camera is reopened."""
    sizes = {"left": (16, 12), "right": (16, 12), name: (16, 13)}
    async with used(Bench(image_sizes=(sizes["left"], sizes["right"]))) as bench:
        with pytest.raises(CameraSetupError, match=f"camera {name}: its image is 16x12 px, .* with 16x13"):
            await bench.head.capture()
        await bench.is_closed(name)


async def test_a_dark_image_is_not_called_frozen() -> None:
    """Repeated black images are pairs, as a dark picture is for the pipeline to report."""
    async with used(Bench(lambda request: np.zeros((request.height, request.width), np.uint8))) as bench:
        for _ in range(3):
            await bench.head.capture()


async def test_a_source_that_repeats_itself_can_be_allowed() -> None:
    """With detect_frozen off, repeated images are pairs."""

    def still(request: ExposureRequest) -> Image:
        image = np.zeros((request.height, request.width), np.uint8)
        image[3, 3] = 9
        return image

    async with used(Bench(still, detect_frozen=False)) as bench:
        for _ in range(3):
            await bench.head.capture()


async def test_pairing_faults_that_stay_reopen_both_cameras() -> None:
    """Repeated pairing faults reopen both cameras."""
    async with used() as bench:
        bench.right.faults.skew_s = 1.0
        for _ in range(REOPEN_AFTER):
            with pytest.raises(PairingError):
                await bench.head.capture()
        await bench.is_closed("left")
        await bench.is_closed("right")
        bench.right.faults.skew_s = 0.0
        await bench.recovers()


# --- opening and back-off -------------------------------------------------------------------------


async def test_back_off_raises_the_last_error_at_once_and_touches_no_camera() -> None:
    """Between attempts a capture raises the last error at once, without touching a camera."""
    async with used(Bench(min_backoff_s=60.0)) as bench:
        bench.left.faults.open_error = CameraUnreachable("left", "no answer")
        attempts = 0

        async def counted() -> None:
            nonlocal attempts
            attempts += 1
            raise CameraUnreachable("left", "no answer")

        bench.left.open = counted
        for _ in range(100):
            with pytest.raises(CameraUnreachable, match="no answer"):
                await bench.head.capture()
        assert 1 == attempts


async def test_the_pause_between_attempts_doubles_up_to_its_limit() -> None:
    """The pauses are 0.1, 0.2, 0.4, 0.4, ... s."""
    now_s = 1000.0
    attempts: list[float] = []
    bench = Bench(min_backoff_s=0.1, max_backoff_s=0.4, clock=lambda: now_s)
    async with used(bench) as bench:

        async def refuse() -> None:
            attempts.append(now_s)
            raise CameraUnreachable("left", "no answer")

        bench.left.open = refuse
        for _ in range(160):
            with pytest.raises(CameraUnreachable):
                await bench.head.open()
            now_s += 0.01

    np.testing.assert_allclose([0.1, 0.2, 0.4, 0.4], np.diff(attempts)[:4], atol=0.011)


async def test_a_slow_attempt_to_open_never_blocks_a_cycle() -> None:
    """While a fault lasts, a capture waits at most one time-out for the attempt to open."""
    gate = asyncio.Event()
    async with used(Bench(timeout_s=TIMEOUT_S)) as bench:
        await bench.head.capture()
        open_really = bench.left.open

        async def slow() -> None:
            await gate.wait()
            await open_really()

        bench.left.open = slow
        bench.left.faults.fail_next_trigger = CameraUnreachable("left", "gone")
        for _ in range(5):
            with pytest.raises(CameraUnreachable, match="gone"):
                await asyncio.wait_for(bench.head.capture(), 20 * TIMEOUT_S)
            await asyncio.sleep(0.01)
        gate.set()
        await bench.recovers()


@SIDES
async def test_a_camera_that_hangs_in_closing_does_not_hold_up_the_cycle(name: str) -> None:
    """The fault is raised at once, and the camera is reopened only after it has been closed."""
    order: list[str] = []
    async with used(Bench(timeout_s=TIMEOUT_S)) as bench:
        camera = bench.side(name)
        await bench.head.capture()
        close_really, open_really, gate = camera.close, camera.open, asyncio.Event()

        async def slow_close() -> None:
            await gate.wait()
            await close_really()
            order.append("closed")

        async def noted_open() -> None:
            order.append("opened")
            await open_really()

        camera.close, camera.open = slow_close, noted_open
        camera.faults.fail_next_trigger = CameraUnreachable(name, "gone")
        with pytest.raises(CameraUnreachable, match="gone"):
            await asyncio.wait_for(bench.head.capture(), LIMIT_S)
        await asyncio.sleep(0.05)
        with pytest.raises(CameraUnreachable, match="gone"):
            await asyncio.wait_for(bench.head.capture(), LIMIT_S)
        gate.set()
        await bench.recovers()
        assert ["closed", "opened"] == order


async def test_an_attempt_that_hangs_is_ended() -> None:
    """An attempt that takes longer than `open_timeout_s` raises CameraUnreachable."""
    async with used(Bench(open_timeout_s=0.05)) as bench:
        bench.right.open = asyncio.Event().wait
        with pytest.raises(CameraUnreachable, match=r"camera right: not open after 0\.05 s"):
            await bench.head.open()


async def test_closing_ends_an_attempt_to_open() -> None:
    """Closing cancels a pending attempt to open."""
    async with used(Bench(open_timeout_s=60.0)) as bench:
        bench.left.open = asyncio.Event().wait
        task = asyncio.create_task(bench.head.open())
        await asyncio.sleep(0.01)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        await asyncio.wait_for(bench.head.close(), LIMIT_S)


async def test_two_cameras_that_are_missing_are_both_named() -> None:
    """One error names both missing cameras."""
    async with used() as bench:
        for side in (bench.left, bench.right):
            side.faults.open_error = CameraUnreachable(side.name, "no answer")
        with pytest.raises(CameraUnreachable) as caught:
            await bench.head.open()
        assert "both cameras: left: no answer; right: no answer" == str(caught.value)


async def test_looking_after_open_cameras_finds_the_one_that_died() -> None:
    """`open` checks cameras that are already open, and a failing one is reopened."""
    async with used() as bench:
        await bench.head.open()
        bench.right.faults.open_error = CameraUnreachable("right", "control lost")
        with pytest.raises(CameraUnreachable, match="control lost"):
            await bench.head.open()
        await bench.is_closed("right")
        assert bench.left.is_open
        bench.right.faults.open_error = None
        await asyncio.sleep(0.03)
        await bench.head.open()
        assert (1, 2) == (bench.left.opened, bench.right.opened)


async def test_a_bug_in_an_adapter_is_not_called_a_camera_fault() -> None:
    """Errors other than `CaptureError` propagate from opening and from exposures."""

    async def broken() -> None:
        raise ZeroDivisionError("a bug")

    async with used() as bench:
        bench.left.open = broken
        with pytest.raises(ZeroDivisionError):
            await bench.head.open()
    async with used() as bench:
        await bench.head.open()
        bench.left.trigger = broken
        with pytest.raises(ZeroDivisionError):
            await bench.head.capture()


async def test_repeated_faults_do_not_grow_their_traceback() -> None:
    """The traceback of a repeatedly raised error does not grow."""

    def length(error: BaseException) -> int:
        traceback, count = error.__traceback__, 0
        while traceback is not None:
            traceback, count = traceback.tb_next, count + 1
        return count

    async with used(Bench(min_backoff_s=60.0)) as bench:
        bench.left.faults.open_error = CameraUnreachable("left", "no answer")
        lengths = []
        for _ in range(20):
            try:
                await bench.head.capture()
            except CameraUnreachable as error:
                lengths.append(length(error))
    assert lengths[1] == lengths[-1]


@pytest.mark.long
async def test_random_faults_give_good_pairs_or_capture_errors_and_nothing_else() -> None:
    """In a thousand exposures with random faults, each returned pair is one new exposure."""
    random = np.random.default_rng(7)

    def stamped(request: ExposureRequest) -> Image:
        image = noise(request)
        image[0, :8] = np.frombuffer(np.int64(request.exposed_ns).tobytes(), np.uint8)
        return image

    async with used(Bench(stamped, timeout_s=0.02, max_skew_s=0.05, min_backoff_s=0.0)) as bench:
        good, bad, newest, last_was_good = 0, 0, 0, False
        for _ in range(1000):
            bench.left.faults, bench.right.faults = InProcessFaults(), InProcessFaults()
            side = bench.side("left" if random.random() < 0.5 else "right")
            kind = random.integers(0, 12)
            side.faults.drop_next = int(kind == 0)
            side.faults.incomplete_next = int(kind == 1)
            side.faults.skew_s = 0.2 if kind == 2 else 0.0
            # a picture that never reached the host cannot be recognised as repeated
            side.faults.frozen = bool(kind == 3) and last_was_good
            last_was_good = False
            if kind == 4:
                side.faults.fail_next_trigger = CameraUnreachable(side.name, "cable")
            try:
                pair = await bench.head.capture()
            except CaptureError:
                bad += 1
                continue
            good, last_was_good = good + 1, True
            stamps = [
                int(np.frombuffer(frame.image[0, :8].tobytes(), np.int64)[0])
                for frame in (pair.left, pair.right)
            ]
            assert abs(stamps[0] - stamps[1]) < 50e6
            assert [pair.left.exposed_ns, pair.right.exposed_ns] == stamps
            assert min(stamps) > newest
            newest = max(stamps)
    assert good > 300
    assert bad > 100


# --- faults have codes of their own -----------------------------------------------------------------


def test_every_capture_error_has_a_code_of_its_own() -> None:
    """The codes of all capture errors are unique."""

    def family(kind: type[CaptureError]) -> list[type[CaptureError]]:
        return [kind, *(one for child in kind.__subclasses__() for one in family(child))]

    codes = [kind.code for kind in family(errors.CaptureError)]
    assert len(codes) == len(set(codes))


async def test_repeated_and_frozen_frames_are_told_apart() -> None:
    """A repeated frame id and a repeated image under a new id are different faults."""
    async with used() as bench:
        await bench.head.capture()
        bench.left.faults.repeat_id = True
        with pytest.raises(FrameRepeated):
            await bench.head.capture()
        bench.left.faults.repeat_id = False
        bench.left.faults.frozen = True
        with pytest.raises(FrameFrozen):
            await bench.head.capture()


async def test_a_camera_that_answers_and_never_shows_anything_has_a_stalled_stream() -> None:
    """One missing image is a time-out; three in a row of a responding camera are a stalled stream."""
    async with used(Bench(timeout_s=TIMEOUT_S)) as bench:
        await bench.head.capture()
        bench.left.faults.stall = True
        kinds = []
        for _ in range(REOPEN_AFTER):
            with pytest.raises(FrameTimeout) as caught:
                await bench.head.capture()
            kinds.append(type(caught.value))
        assert [FrameTimeout, FrameTimeout, StreamStalled] == kinds


async def test_after_a_missing_image_the_camera_is_asked_why() -> None:
    """After a missing image, a camera taken by another host is reported at the next cycle."""
    async with used(Bench(timeout_s=TIMEOUT_S)) as bench:
        await bench.head.capture()
        bench.left.faults.stall = True
        with pytest.raises(FrameTimeout):
            await bench.head.capture()
        bench.left.faults.open_error = CameraBusy("left", "another host controls it")
        with pytest.raises(CameraBusy, match="another host"):
            await bench.head.capture()


# --- trigger order ------------------------------------------------------------------------------------


@SIDES
async def test_the_follower_is_armed_before_the_other_is_triggered(name: str) -> None:
    """The follower is always armed before the other camera is triggered, however long arming takes."""
    order: list[str] = []
    async with used(Bench(follower=name, timeout_s=5.0)) as bench:
        for side in (bench.left, bench.right):
            really = side.trigger

            async def noted(really: Any = really, side: InProcessCamera = side) -> None:
                if side.name == name:
                    await asyncio.sleep(0.02)
                await really()
                order.append(side.name)

            side.trigger = noted
        await bench.head.capture()
    assert [name, "right" if name == "left" else "left"] == order
