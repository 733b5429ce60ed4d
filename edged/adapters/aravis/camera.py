"""`AravisCamera`: a GenICam camera behind the `Camera` port.

Responsible for: one control thread and one pump thread, deadlines, and verifying that an image belongs to the
last trigger. Not responsible for: retries (`capture` makes them), the content of the image.

Times. `device_ns` is the camera's own time stamp of the image. `exposed_ns` is the same moment in host UTC,
by a map between both clocks that is updated with every trigger (`clock`); `exposed_bound_ns` bounds its
error. A clock that cannot be read is mapped by the images: each was exposed between its command and its
arrival. Without time stamps, the exposure is assumed at the moment when the command left this program (a
command that had to be repeated is a fault) or, with every other trigger source, when the first packet
arrived.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import logging
import queue
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, TypeVar

from edged.adapters.aravis.clock import Mapped, to_utc
from edged.adapters.aravis.exposure import StreamLocks
from edged.adapters.aravis.features import Value
from edged.adapters.aravis.session import CameraDescription, CameraHealth, CameraSession
from edged.adapters.aravis.settings import AravisSettings
from edged.adapters.aravis.stream import Arrival
from edged.adapters.aravis.trigger import FreeRun, Software
from edged.domain.exposure import CameraLimits, CameraValues
from edged.domain.frames import Frame, TimeBase
from edged.errors import CameraSetupError, CameraUnreachable, CaptureError, FrameIncomplete, FrameTimeout

log = logging.getLogger(__name__)

REPLY_S = 1.2
"""A command not answered by then has been lost twice (Aravis repeats it after 0.5 s): the camera is gone."""

BACKLOG = 4
"""Most images waiting to be fetched; when an external trigger is too fast, the oldest is dropped."""

ADJUST_S = 3.0
"""Time limit for `adjust`: some registers are written and read, and each command may have to be repeated."""

DESCRIPTION_S = 30.0
"""Time limit for `description`: of hundreds of features, some are read to see whether they are available."""

CLOSE_S = 1.0
"""A camera that answers is closed within milliseconds; one that does not is left to its thread."""

PREDECESSOR_S = 2.0
"""How long a new connection waits for the old one to give up control of the camera. A dead camera blocks its
thread for up to 10 s, but then there is no control to give up."""

SETTLE_S = 2.0
"""Time for the longest exposure of a cell and its transfer."""

FRAME_S = 10.0
"""Longest wait for an image, whatever the caller's own deadline."""

STAMP_NS = 1_000_000
"""Tolerance of time stamps: some firmware stamps an exposure up to this long before the command left, or
after the first packet arrived."""

DELIVERY_NS = 100_000_000
"""With an external trigger, the first packet arrives no later than this after the end of the exposure."""

Result = TypeVar("Result")


_Job = tuple[concurrent.futures.Future[Any], Callable[[], Any]]


class _Connection:
    """One connection to the camera, with one thread for all its calls: Aravis objects are not thread-safe.

    Unlike an executor's, it is a daemon thread: a dead camera blocks a call for seconds, and must not delay
    the end of the program.
    """

    def __init__(self, name: str, predecessor: threading.Thread | None) -> None:
        self.session: CameraSession | None = None
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._closed: Callable[[], None] = lambda: None
        self.thread = threading.Thread(target=self._run, args=(predecessor,), name=name, daemon=True)
        self.thread.start()

    def submit(self, job: Callable[[], Result]) -> concurrent.futures.Future[Result]:
        """Queue a job; cancelling its future before it starts means it never runs."""
        future: concurrent.futures.Future[Result] = concurrent.futures.Future()
        self._jobs.put((future, job))
        return future

    def close(self, closed: Callable[[], None]) -> None:
        """After the queued jobs, close the session, call `closed`, and end the thread."""
        self._closed = closed
        self._jobs.put(None)

    def _run(self, predecessor: threading.Thread | None) -> None:
        if predecessor is not None:
            predecessor.join(PREDECESSOR_S)
        while (item := self._jobs.get()) is not None:
            future, job = item
            if not future.set_running_or_notify_cancel():
                continue
            try:
                result = job()
            except CaptureError as error:
                log.debug("%s", error, exc_info=True)
                future.set_exception(_without_traceback(error))
            except BaseException as error:  # noqa: BLE001  (a bug: raised by the await of the job)
                future.set_exception(error)
            else:
                future.set_result(result)
            del future, job, item  # else the last job's objects live until the next one
        if self.session is not None:
            self.session.close()
        self._closed()


def _without_traceback(error: CaptureError) -> CaptureError:
    """Return the error without its traceback and cause, whose frames refer to the camera and keep it open."""
    error.__cause__ = error.__context__ = None
    return error.with_traceback(None)


class AravisCamera:
    """One GenICam camera. Construct it anywhere; use it from one event loop."""

    def __init__(self, name: str, settings: AravisSettings) -> None:
        self._name = name
        self._settings = settings
        self._draft = CameraValues()
        self._found: Mapping[str, Value] = {}
        self._connection: _Connection | None = None
        self._last_thread: threading.Thread | None = None
        self._arrivals: deque[Arrival] = deque()
        self._news = asyncio.Event()
        self._awaiting = False
        self._triggers = 0
        self._sent_ns = 0
        self._last_frame_id = 0
        self._stamps_fit = True

    @property
    def name(self) -> str:
        """ "left" or "right"."""
        return self._name

    @property
    def health(self) -> CameraHealth | None:
        """Health of the camera; None while it is not open."""
        session = self._connection.session if self._connection is not None else None
        return session.health() if session is not None else None

    async def open(self) -> None:
        """Connect, set up and arm; of an open camera, check that it answers and is under our control.

        Raises `CameraUnreachable`, `CameraBusy` or `CameraSetupError`. Takes as long as Aravis does: 1 s of
        discovery for a serial number, up to 3 s for an address that does not answer.
        """
        if self._connection is not None and self._connection.session is not None:
            connection, session = self._opened()
            await self._call(connection, session.probe, REPLY_S)
            return
        if self._connection is None:
            self._connection = _Connection(f"control {self._name}", self._last_thread)
            self._last_thread = self._connection.thread
        connection = self._connection
        settings = self._in_force()
        arrivals: deque[Arrival] = deque(maxlen=BACKLOG)  # new: the last connection's pump must not add to it
        news = asyncio.Event()
        self._arrivals, self._news = arrivals, news
        self._awaiting = False
        self._triggers = 0
        self._stamps_fit = True

        def arrived(arrival: Arrival) -> None:
            arrivals.append(arrival)
            news.set()

        deliver, lost = _on_loop(arrived), _on_loop(news.set)

        def connect() -> None:
            connection.session = CameraSession(self._name, settings, deliver, lost, self._last_frame_id)

        await self._call(connection, connect, None)
        if self._draft == CameraValues():
            self._found = {}  # they have been written back

    async def trigger(self) -> None:
        """Start one exposure; earlier frames that were not fetched are dropped.

        A camera with an external trigger is only armed: `frame` returns images exposed from now on.
        """
        connection, session = self._opened()
        restart = session.triggers_itself and self._awaiting and not self._arrivals
        self._awaiting = True
        self._triggers += 1
        self._arrivals.clear()

        def fire() -> int:
            if restart:  # an abandoned exposure is still under way
                session.restart()
            return session.trigger()

        self._sent_ns = await self._call(connection, fire, REPLY_S)

    async def frame(self) -> Frame:
        """Return the image of the last trigger, or raise `FrameTimeout` / `FrameIncomplete`.

        With an external trigger, return the oldest image not yet fetched. A cancelled call loses none.
        """
        _, session = self._opened()
        if session.triggers_itself and not self._awaiting:
            raise FrameTimeout(self._name, "no exposure was triggered")
        try:
            async with asyncio.timeout(FRAME_S):
                arrival = await self._next_arrival(session)
        except TimeoutError:
            raise FrameTimeout(self._name, f"no image within {FRAME_S:g} s") from None
        self._awaiting = False
        if arrival.image is None:
            raise FrameIncomplete(self._name, arrival.problem)
        self._last_frame_id = arrival.frame_id
        exposed, base = self._exposed(session, arrival)
        utc = to_utc(exposed)
        return Frame(
            self._name, arrival.frame_id, arrival.image, arrival.device_ns, utc.at_ns, utc.bound_ns, base,
            arrival.count,
        )  # fmt: skip

    # --- setting up ----------------------------------------------------------------------------

    async def adjust(self, values: CameraValues) -> CameraValues:
        """Set exposure time and gain until `restore`; return the values that the camera actually has then.

        They outlive a lost connection. A camera that locks them while it streams is reopened.
        Raises `CameraSetupError` for a setting that the camera does not have or accept; then nothing has
        changed.
        """
        connection, session = self._opened()
        if not self._found:
            self._found = await self._call(connection, session.as_found, REPLY_S)
        made = await self._call(connection, lambda: session.adjust(values), ADJUST_S)
        if isinstance(made, StreamLocks):
            log.info(
                "camera %s: reopened for a feature that is locked while it streams: %s", self._name, made.why
            )
            return await self._opened_with(values)
        self._draft = _stated(values, made).over(self._draft)
        await self._settle(connection, session)
        return made

    async def description(self) -> CameraDescription:
        """Maker, model, firmware and features of the camera. Raises `CaptureError`."""
        connection, session = self._opened()
        return await self._call(connection, session.description, DESCRIPTION_S)

    async def limits(self) -> CameraLimits:
        """Current limits of exposure time and gain."""
        connection, session = self._opened()
        return await self._call(connection, session.limits, REPLY_S)

    async def restore(self) -> None:
        """Undo `adjust`.

        Raises `CaptureError`; then the camera is closed, and the values are written when it is opened again.
        """
        self._draft = CameraValues()
        if not self._found or self._connection is None:
            return
        try:
            connection, session = self._opened()
            await self._call(connection, lambda: session.write_back(self._found), ADJUST_S)
            await self._settle(connection, session)
        except CaptureError:
            await self.close()
            raise
        self._found = {}

    async def _settle(self, connection: _Connection, session: CameraSession) -> None:
        """Discard an exposure that may still have the old values: many sensors apply new ones a frame late.

        Only with a software trigger, where no one else sees it. If the image does not come, go on without it.
        """
        if not isinstance(session.settings.trigger, Software):
            return
        self._arrivals.clear()
        self._awaiting = True
        self._triggers += 1
        with contextlib.suppress(FrameTimeout):
            self._sent_ns = await self._call(connection, session.trigger, REPLY_S)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(SETTLE_S):
                await self._next_arrival(session)
            self._awaiting = False

    def _in_force(self) -> AravisSettings:
        """The configured settings, with adjusted values, or with values still to be written back."""
        settings = self._settings
        if self._draft == CameraValues():
            return replace(settings, features=(*settings.features, *([self._found] if self._found else [])))
        values = self._draft.over(CameraValues(settings.exposure_us, settings.gain_db))
        return replace(settings, exposure_us=values.exposure_us, gain_db=values.gain_db)

    async def _opened_with(self, values: CameraValues) -> CameraValues:
        before, self._draft = self._draft, values.over(self._draft)
        await self.close()
        try:
            await self.open()
        except CaptureError as error:
            self._draft = before
            await self.close()
            if isinstance(error, CameraSetupError):
                await self.open()
            raise
        connection, session = self._opened()
        return await self._call(connection, session.values, REPLY_S)

    async def close(self) -> None:
        """Release the camera; safe to call twice and on a camera that was never opened.

        A camera that does not answer is released by its thread, within seconds, after this has returned.
        """
        connection, self._connection = self._connection, None
        if connection is None:
            return
        closed = asyncio.Event()
        connection.close(_on_loop(closed.set))
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(closed.wait(), CLOSE_S)

    # --- inside ------------------------------------------------------------------------------

    def _opened(self) -> tuple[_Connection, CameraSession]:
        connection = self._connection
        session = connection.session if connection is not None else None
        if connection is None or session is None:
            raise CameraUnreachable(self._name, "not open")
        self._raise_if_lost(session)
        return connection, session

    def _raise_if_lost(self, session: CameraSession) -> None:
        if session.lost.is_set():
            raise CameraUnreachable(self._name, "the connection was lost")

    async def _call(
        self, connection: _Connection, job: Callable[[], Result], limit_s: float | None
    ) -> Result:
        """Run a job on the control thread; it is cancelled if it has not begun when the time is up."""
        try:
            return await asyncio.wait_for(asyncio.wrap_future(connection.submit(job)), limit_s)
        except TimeoutError:
            raise CameraUnreachable(self._name, f"no answer within {limit_s:g} s") from None

    async def _next_arrival(self, session: CameraSession) -> Arrival:
        """Next buffer that is not stale. Raises `CameraUnreachable` as soon as the camera is lost."""
        while True:
            while self._arrivals:
                arrival = self._arrivals.popleft()
                if not self._is_stale(session, arrival):
                    return arrival
                log.debug("camera %s: frame %d came too late and is dropped", self._name, arrival.frame_id)
            self._raise_if_lost(session)
            self._news.clear()
            await self._news.wait()

    def _is_stale(self, session: CameraSession, arrival: Arrival) -> bool:
        """Whether a buffer was exposed before the last trigger command was sent.

        In doubt, an image of a free-running camera counts as stale, since another follows soon; any other
        image does not.
        """
        if self._triggers == 0 or (session.triggers_itself and self._triggers == 1):
            return False  # never armed, or the first trigger of a connection: nothing came before it
        mapped = session.clock.at(arrival.device_ns) if self._stamps_fit else None
        if mapped is None:
            return False
        free = isinstance(session.settings.trigger, FreeRun)
        doubt_ns = -mapped.bound_ns if free else mapped.bound_ns + STAMP_NS
        return mapped.at_ns + doubt_ns < self._sent_ns

    def _exposed(self, session: CameraSession, arrival: Arrival) -> tuple[Mapped, TimeBase]:
        """Host time of the exposure with the bound of its error, and the source of that time."""
        took_ns = DELIVERY_NS + session.exposure_ns
        earliest_ns = self._sent_ns if session.triggers_itself else arrival.arrived_ns - took_ns
        session.note_exposure(earliest_ns, arrival)
        mapped = session.clock.at(arrival.device_ns) if arrival.device_ns else None
        if mapped is not None:
            margin_ns = mapped.bound_ns + STAMP_NS
            fits = earliest_ns - margin_ns <= mapped.at_ns <= arrival.arrived_ns + margin_ns
            if not fits and self._stamps_fit:
                off_s = (mapped.at_ns - earliest_ns) * 1e-9
                log.warning(
                    "camera %s: its time stamps do not fit its clock (%.3f s off): host time is used",
                    self._name,
                    off_s,
                )
            self._stamps_fit = fits
            if fits:
                return mapped, TimeBase.PTP if session.ptp else TimeBase.CAMERA
        bound_ns = arrival.arrived_ns - earliest_ns
        if session.triggers_itself:
            return Mapped(earliest_ns, bound_ns), TimeBase.HOST
        return Mapped(arrival.arrived_ns, bound_ns), TimeBase.ARRIVAL


def _stated(values: CameraValues, made: CameraValues) -> CameraValues:
    """The camera's actual values, only for the settings that were requested."""
    return CameraValues(
        None if values.exposure_us is None else made.exposure_us,
        None if values.gain_db is None else made.gain_db,
    )


def _on_loop(action: Callable[..., object]) -> Callable[..., None]:
    """Wrap an action so that it can be called from any thread and runs on the current event loop."""
    loop = asyncio.get_running_loop()

    def call(*arguments: object) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed
            loop.call_soon_threadsafe(action, *arguments)

    return call
