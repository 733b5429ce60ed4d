"""Zenoh: results for other processes, other machines and fleets, and commands from them.

Responsible for: sessions, threads, `keys`, seals and quality of service. Not responsible for the format of
messages (`edged.payload`) nor for carrying out commands (`Commander`).

Nothing here blocks the event loop, which owns all state. Two threads make the calls that may block: one
publishes and one answers queries, so that a stalled querier cannot delay subscribers. A full outbox drops its
oldest message, which shows as a gap in `sequence`: a late coordinate is worth less than the next one. For the
same reason messages are dropped on congestion.
"""

from __future__ import annotations

import asyncio
import functools
import logging
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import zenoh
import zenoh.ext

from edged.adapters.zenoh.health import HealthCounts
from edged.adapters.zenoh.keys import PREFIX, QUERYABLES
from edged.adapters.zenoh.preview import Preview
from edged.adapters.zenoh.ros2 import Ros2Topics, pose_of
from edged.adapters.zenoh.seals import Sealer
from edged.adapters.zenoh.session import ZenohSettings, configured, open_session, plain
from edged.adapters.zenoh.triggers import PendingTriggers, parse_trigger
from edged.adapters.zenoh.worker import JobThread
from edged.cbor import encode_cbor
from edged.cell.ages import ExposureClock
from edged.cell.tasks import bounded
from edged.domain.cell import CellPhase, CellState
from edged.domain.events import (
    Basis,
    Command,
    CommandFailed,
    Event,
    ExposureDone,
    JobChanged,
    Registered,
    Snapshot,
)
from edged.errors import CommandRefused, ConfigError, ListenError
from edged.payload import (
    Json,
    command_to_json,
    encode,
    message,
    registered_to_json,
    snapshot_to_json,
    state_to_json,
)
from edged.ports import Commander

log = logging.getLogger(__name__)

HEALTH_PERIOD_S = 1.0
OUTBOX_LENGTH = 64  # a second of the fastest cell; more would only be old news
MAX_PENDING = 32  # triggers that wait for their answer
OPEN_TIMEOUT_S = 5.0
CLOSE_TIMEOUT_S = 1.0
PATIENCE = 5
"""Number of looks for routers, a second apart, after which a cell that has found none logs it."""
ENCODINGS: dict[str, tuple[Callable[[Json], bytes], zenoh.Encoding]] = {
    "json": (encode, zenoh.Encoding.APPLICATION_JSON),
    "cbor": (encode_cbor, zenoh.Encoding.APPLICATION_CBOR),
}


class ZenohPublisher:
    """Publishes one cell over Zenoh and takes its commands (`edged.ports.Publisher`).

    commander : receives the commands of `trigger`; None: the cell is read-only.
    jobs : returns (number, name) of every job. config : returns the reply to `config`, which must hold no
    secrets. Both are called on the event loop.
    session : result of `configured`; None: its files are read by `start`.
    """

    def __init__(
        self,
        settings: ZenohSettings,
        commander: Commander | None,
        *,
        jobs: Callable[[], Sequence[tuple[int, str]]] = tuple,
        config: Callable[[], Mapping[str, Any]] = dict,
        session: zenoh.Config | None = None,
    ) -> None:
        self._settings = settings
        self._commander = commander
        self._jobs = jobs
        self._config = config
        self._exposures = ExposureClock(time.monotonic)
        self._session_config = session
        self._encode, self._encoding = ENCODINGS[settings.encoding]
        self._base = f"{PREFIX}/{settings.cell}"
        self._session: zenoh.Session | None = None
        self._sealer = Sealer("", None, time.time_ns)  # nothing is sent before there is a session
        self._ros2: Ros2Topics | None = None
        self._preview: Preview | None = None
        self._publishers: dict[str, zenoh.ext.AdvancedPublisher | zenoh.Publisher] = {}
        self._sequences = {"target": 0, "state": 0, "health": 0}
        self._started_ns = time.time_ns()
        self._outbox = JobThread("zenoh-publish", OUTBOX_LENGTH)
        self._answers = JobThread("zenoh-answer", 2 * MAX_PENDING)
        self._triggers: PendingTriggers[zenoh.Query] = PendingTriggers()
        self._closed = False
        self._health = HealthCounts()
        self._routers = Routers(settings.connect)
        self._heartbeat: asyncio.Task[None] | None = None
        self._last: tuple[Snapshot, int, float] | None = None
        self._state: CellState | None = None

    # --- Publisher -------------------------------------------------------------------------

    async def start(self) -> None:
        """Open the session. Raises `ListenError`, or `ConfigError` for an unreadable configuration."""
        config = self._session_config or configured(self._settings)
        what = f"zenoh: opening {', '.join(self._settings.listen) or 'its session'}"
        self._session = session = await bounded(
            lambda: open_session(config), OPEN_TIMEOUT_S, what, zenoh.Session.close
        )
        self._sealer = Sealer(str(session.zid()), self._settings.shared_key, time.time_ns)
        try:
            self._declare(session)
        except ConfigError:
            await self.close()
            raise
        except zenoh.ZError as error:
            await self.close()
            raise ListenError(f"zenoh: {self._base}: {plain(error)}") from error
        for worker in self._workers():
            worker.start()
        self._heartbeat = asyncio.create_task(self._beat(), name="zenoh-health")
        log.info("zenoh: publishing %s, session %s", self._base, session.zid())

    def announce(self, event: Event) -> None:
        """Queue the messages of an event, and the reply to the trigger that caused it."""
        if self._closed or self._session is None:
            return
        if isinstance(event, Snapshot):
            sequence = self._publish("target", lambda: snapshot_to_json(event))
            self._last = (event, sequence, self._exposures.exposed_s(event))
            self._publish_ros2(event)
            self._health.count(event)
            self._answer_command(
                event.command, lambda: self._message("target", snapshot_to_json(event), sequence)
            )
        elif isinstance(event, Basis):
            self._last = None  # its basis is no longer in use
        elif isinstance(event, ExposureDone):
            self._exposures.note(event)
            if self._preview is not None:
                self._preview.offer(event)
        elif isinstance(event, CellState):
            self._state = event
            body = self._dated(state_to_json(event))
            self._publish("state", lambda: body)
        elif isinstance(event, JobChanged):
            document = self._message("job", self._dated({"job_number": event.number, "job": event.name}))
            self._answer_command(event.command, lambda: document)
        elif isinstance(event, Registered) and event.obstacle is None:
            state = self._message("registration", self._dated(registered_to_json(event)))
            self._answer_command(event.command, lambda: state)
        elif isinstance(event, Registered) and event.obstacle is not None:
            self._settle(event.command, f"{event.obstacle.name}: {event.why}")
        elif isinstance(event, CommandFailed):
            self._settle(event.command, event.reason)

    async def close(self) -> None:
        """Withdraw the cell, answer waiting triggers, stop both threads; bounded in time."""
        if self._closed:
            return
        self._closed = True
        if self._heartbeat is not None:
            self._heartbeat.cancel()
            await asyncio.wait({self._heartbeat})
        for command in self._triggers.commands():
            self._settle(command, "the daemon is stopping")
        session, self._session = self._session, None
        try:
            for worker in self._workers():
                await bounded(
                    functools.partial(worker.stop, CLOSE_TIMEOUT_S), 2 * CLOSE_TIMEOUT_S, "zenoh: stopping"
                )
            if session is not None:
                await bounded(session.close, CLOSE_TIMEOUT_S, "zenoh: closing")
        except (ListenError, zenoh.ZError) as error:
            log.warning("zenoh: the session did not close cleanly: %s", plain(error))

    def _workers(self) -> list[JobThread | Preview]:
        return [self._outbox, self._answers, *([self._preview] if self._preview is not None else [])]

    def links(self) -> int:
        """Number of connected Zenoh nodes."""
        if self._session is None:
            return 0
        info = self._session.info
        return len(info.routers_zid()) + len(info.peers_zid())

    # --- publishing ------------------------------------------------------------------------

    def _declare(self, session: zenoh.Session) -> None:
        declare = functools.partial(
            zenoh.ext.declare_advanced_publisher,
            session,
            cache=zenoh.ext.CacheConfig(max_samples=1),
            publisher_detection=True,
            congestion_control=zenoh.CongestionControl.DROP,
            encoding=self._encoding,
            express=True,  # not batched
        )
        self._publishers = {
            "target": declare(f"{self._base}/target", priority=zenoh.Priority.REAL_TIME),
            "state": declare(f"{self._base}/state", priority=zenoh.Priority.INTERACTIVE_HIGH),
            "health": session.declare_publisher(
                f"{self._base}/health",
                priority=zenoh.Priority.DATA_LOW,
                congestion_control=zenoh.CongestionControl.DROP,
                encoding=self._encoding,
            ),
        }
        loop = asyncio.get_running_loop()
        self._declared = [
            session.declare_queryable(
                f"{self._base}/{name}", _on_loop(loop, name, self._on_query), complete=True
            )
            for name in QUERYABLES
        ]
        self._preview = Preview(session, self._base)
        if self._settings.ros2_domain_id is not None:
            self._ros2 = Ros2Topics(session, self._settings.ros2_domain_id, self._settings.cell)
        self._token = session.liveliness().declare_token(f"{self._base}/alive")

    def _publish(self, kind: str, body: Callable[[], Json]) -> int:
        """Queue a message, which is encoded on the publishing thread; return its sequence."""
        self._sequences[kind] += 1
        sequence, publisher = self._sequences[kind], self._publishers[kind]

        def send() -> None:
            payload = self._encode(self._message(kind, body(), sequence))
            publisher.put(payload, attachment=self._sealer.attachment(f"{self._base}/{kind}", payload))

        self._outbox.post(send)
        return sequence

    def _publish_ros2(self, snapshot: Snapshot) -> None:
        topics = self._ros2
        if topics is None:
            return
        pose, sent_ns = pose_of(snapshot, topics.cell), time.time_ns()
        if pose is not None:
            self._outbox.post(lambda: topics.send(pose, sent_ns))

    def _message(self, kind: str, body: Mapping[str, Any], sequence: int | None = None) -> Json:
        return message(kind, self._settings.cell, self._started_ns, body, sequence)

    def _dated(self, body: Mapping[str, Any]) -> Json:
        return {"published_ns": time.time_ns(), **body}

    async def _beat(self) -> None:
        while True:
            await asyncio.sleep(HEALTH_PERIOD_S)
            if self._session is not None:
                self._routers.look(str(router) for router in self._session.info.routers_zid())
            health = {
                "state": CellPhase.STARTING if self._state is None else self._state.state,
                **self._health.to_json(),
                "links": self.links(),
                "pending_triggers": len(self._triggers),
                "messages_dropped": self._outbox.dropped,
                "messages_failed": self._outbox.failed,
            }
            self._publish("health", functools.partial(self._dated, health))

    # --- answering -------------------------------------------------------------------------

    def _on_query(self, name: str, query: zenoh.Query) -> None:
        """Answer a query; called on the event loop."""
        if self._closed:
            self._reply_error(query, "the daemon is stopping")
        elif name == "trigger":
            self._on_trigger(query)
        elif name == "last":
            self._on_last(query)
        elif name == "jobs":
            active = self._state.job_number if self._state is not None else None
            jobs = [{"number": n, "name": job, "active": n == active} for n, job in self._jobs()]
            document = self._message("jobs", self._dated({"jobs": jobs}))
            self._reply(query, name, lambda: document)
        else:
            document = self._message("config", self._dated({"config": dict(self._config())}))
            self._reply(query, name, lambda: document)

    def _on_last(self, query: zenoh.Query) -> None:
        if self._last is None:
            self._reply_error(query, "nothing has been measured since the start or the last reload")
            return
        snapshot, sequence, exposed_s = self._last
        age_ms = (time.monotonic() - exposed_s) * 1e3
        self._reply(
            query,
            "last",
            lambda: {**self._message("target", snapshot_to_json(snapshot), sequence), "age_ms": age_ms},
        )

    def _on_trigger(self, query: zenoh.Query) -> None:
        key = f"{self._base}/trigger"
        if str(query.key_expr) != key:  # a query by wildcards must not trigger
            self._reply_error(query, f"a trigger must name its key, {key}")
            return
        try:
            asked = parse_trigger(query.parameters, self._settings.trigger_timeout_s)
        except CommandRefused as error:
            self._reply_error(query, str(error))
            return
        if self._commander is None:
            self._reply_error(query, "this cell takes no commands over Zenoh")
            return
        if len(self._triggers) >= MAX_PENDING:
            self._reply_error(query, f"{MAX_PENDING} triggers are waiting already")
            return
        command = self._triggers.add(
            query,
            asked.kind,
            asked.job,
            asked.robot_from_flange,
            tries_all=asked.tries_all,
            shown=asked.shown,
        )
        late = f"no result within {asked.timeout_s:g} s"
        loop = asyncio.get_running_loop()
        self._triggers.limit(command, loop.call_later(asked.timeout_s, self._settle, command, late))
        try:
            self._commander.submit(command)
        except CommandRefused as error:
            self._settle(command, str(error))

    def _answer_command(self, command: Command | None, document: Callable[[], Json]) -> None:
        query = self._triggers.take(command)
        if query is not None:
            self._reply(query, "trigger", document)

    def _settle(self, command: Command, reason: str) -> None:
        """Answer a trigger with an error."""
        query = self._triggers.take(command)
        if query is not None:
            self._reply_error(query, reason, command)

    def _reply(self, query: zenoh.Query, name: str, document: Callable[[], Json]) -> None:
        key, asked = f"{self._base}/{name}", str(query.parameters)

        def send() -> None:
            with query:
                payload = self._encode(document())
                seal = self._sealer.attachment(key, payload, asked)
                query.reply(key, payload, encoding=self._encoding, attachment=seal)

        self._answers.post(send)

    def _reply_error(self, query: zenoh.Query, reason: str, command: Command | None = None) -> None:
        body: Json = {"session": self._sealer.session, "error": reason}  # an error has no attachment
        if command is not None:
            body["command"] = command_to_json(command)
        document = self._message("error", self._dated(body))

        def send() -> None:
            with query:
                query.reply_err(self._encode(document), encoding=self._encoding)

        self._answers.post(send)


def _on_loop(
    loop: asyncio.AbstractEventLoop, name: str, handle: Callable[[str, zenoh.Query], None]
) -> Callable[[zenoh.Query], None]:
    """Make a callback for a queryable, called on a thread of Zenoh, that passes queries to the event loop."""

    def arrived(query: zenoh.Query) -> None:
        try:
            loop.call_soon_threadsafe(handle, name, query)
        except RuntimeError:  # the loop is closed
            query.drop()  # type: ignore[no-untyped-call]  # its stub says no type

    return arrived


class Routers:
    """Logs when a router connects or disconnects. endpoints : those that the cell connects to."""

    def __init__(self, endpoints: Sequence[str]) -> None:
        self._endpoints = ", ".join(endpoints)
        self._known: frozenset[str] = frozenset()
        self._looks = 0

    def look(self, routers: Iterable[str]) -> None:
        """Take the ids of the routers that are connected now, and log changes."""
        now = frozenset(routers)
        for router in sorted(self._known - now):
            log.warning("zenoh: the router %s is gone; the cell goes on and connects again by itself", router)
        for router in sorted(now - self._known):
            log.info("zenoh: connected to the router %s", router)
        self._known = now
        self._looks += 1
        if self._looks == PATIENCE and self._endpoints and not now:
            log.warning("zenoh: no router answers at %s; the cell goes on and tries again", self._endpoints)
