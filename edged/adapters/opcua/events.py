"""Events of a cell: what changed from one picture to the next, as OPC 40100-1 names it."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from datetime import UTC, datetime

from asyncua import ua
from asyncua.common.events import Event

from edged.adapters.opcua.model import Model, type_node
from edged.adapters.opcua.nodes import MACHINE, SYSTEM, base, in_cell
from edged.adapters.opcua.picture import RegisterPicture, ResultRecord, job_name
from edged.adapters.opcua.session import Server
from edged.adapters.opcua.state import Automatic, Top, VisionState
from edged.adapters.opcua.structures import (
    RESULT_KINDS,
    JobIdDataType,
    RecipeIdInternalDataType,
    ResultDataType,
)
from edged.domain.events import CommandKind
from edged.logs import LogLimit
from edged.plc import registers as reg

JOB_STARTED, READY, RECIPE_PREPARED, RESULT_READY, ACQUISITION_DONE = 1013, 1023, 1022, 1024, 1025
STATE_CHANGED, ERROR_EVENT, ERROR_RESOLVED = 1018, 1019, 1020
SEVERE, USUAL = 800, 100

EventContent = tuple[int, str, int, Mapping[str, tuple[object, ua.VariantType]]]
"""Number of its type, message, severity, and its own fields."""


class CellEvent(Event):
    """An event of which clients can select only the declared fields, not other attributes of the object."""

    def to_event_fields(self, select_clauses: list[ua.SimpleAttributeOperand]) -> list[ua.Variant]:
        """Values of the fields that a client selected by their browse paths; null for unknown ones."""
        return [self._field(clause) for clause in select_clauses]

    def _field(self, clause: ua.SimpleAttributeOperand) -> ua.Variant:
        name = "/".join(part.Name or "" for part in clause.BrowsePath or ())
        kind = self.data_types.get(name)
        value = getattr(self, name) if kind is not None else None
        return ua.Variant(None) if value is None else ua.Variant(value, kind)


class CellEvents:
    """Emits the events of one cell."""

    def __init__(self, server: Server, cell: str, model: Model) -> None:
        self._server = server
        self._cell = cell
        self._model = model
        self._log = LogLimit(__name__)

    def of_change(
        self,
        before: RegisterPicture | None,
        picture: RegisterPicture,
        state: VisionState,
        new: VisionState,
        result_data: Callable[[ResultRecord], ResultDataType],
    ) -> Iterator[EventContent]:
        """Events of the change from one picture and state to the next."""
        now, old = picture.values, before.values if before is not None else None
        kind = ua.VariantType.ExtensionObject
        job = JobIdDataType(ua.String(job_name(int(now["START_EPOCH"]), int(now["LAST_SEQ"]))))
        if old is not None:
            is_job = now["COMMAND"] != CommandKind.CHANGE_JOB
            done = now["DONE_SEQ"] == now["LAST_SEQ"] and int(now["STATUS_BITS"]) & reg.StatusBit.ACK
            is_new = now["LAST_SEQ"] != old["LAST_SEQ"] and bool(now["OPEN_COMMANDS"] or done)
            if is_job and is_new:
                yield JOB_STARTED, "The job has started", USUAL, {"JobId": (job, kind)}
            if is_new and done and state == new and state.automatic is Automatic.READY:
                # begun and done between two pictures: report the states in between all the same
                passed = Automatic.SINGLE_EXECUTION if is_job else Automatic.INITIALIZED
                between = replace(state, automatic=passed)
                yield from self._transition(state, between, job, picture)
                state = between
            if int(now["STATUS_BITS"]) & ~int(old["STATUS_BITS"]) & reg.StatusBit.EXPOSURE_DONE:
                yield ACQUISITION_DONE, "Both images are in memory", USUAL, {"JobId": (job, kind)}
            if now["ACTIVE_JOB"] != old["ACTIVE_JOB"]:
                name = next((name for number, name in picture.jobs if number == now["ACTIVE_JOB"]), "")
                recipe = RecipeIdInternalDataType(Id=ua.String(name))
                yield RECIPE_PREPARED, f"{name} is loaded", USUAL, {"InternalId": (recipe, kind)}
        shown = before.result.name if before is not None and before.result is not None else ""
        if picture.result is not None and picture.result.name != shown:
            yield RESULT_READY, "The result is ready", USUAL, _result_fields(result_data(picture.result))
        if state != new:
            yield from self._transition(state, new, job, picture)

    def _transition(
        self, state: VisionState, new: VisionState, job: JobIdDataType, picture: RegisterPicture
    ) -> Iterator[EventContent]:
        cause = transition_cause(picture, new.automatic)
        if new.top is not state.top:
            kind = STATE_CHANGED
            if Top.ERROR in (new.top, state.top):
                kind = ERROR_EVENT if new.top is Top.ERROR else ERROR_RESOLVED
            said = self._transition_fields(state.top.value[2], new.top.value[2], cause)
            severity = SEVERE if new.top is Top.ERROR else USUAL
            yield kind, f"{state.top.value[2]} to {new.top.value[2]}", severity, said
        elif new.automatic is not None and state.automatic is not None:
            names = state.automatic.value[2], new.automatic.value[2]
            yield STATE_CHANGED, " to ".join(names), USUAL, self._transition_fields(*names, cause)
        if new.automatic is Automatic.READY:
            yield READY, "Ready for the next job", USUAL, {"JobId": (job, ua.VariantType.ExtensionObject)}

    def _transition_fields(
        self, source: str, target: str, cause: str
    ) -> dict[str, tuple[object, ua.VariantType]]:
        text, node = ua.VariantType.LocalizedText, ua.VariantType.NodeId
        ids = {state.value[2]: type_node(state.value[1]) for state in (*Top, *Automatic)}
        rows = {row.name: row for row in self._model.rows}
        found = rows.get(f"{source}To{target}{cause}", rows.get(f"{source}To{target}Auto"))
        found_fields: dict[str, tuple[object, ua.VariantType]] = {
            "FromState": (ua.LocalizedText(source), text),
            "FromState/Id": (ids[source], node),
            "ToState": (ua.LocalizedText(target), text),
            "ToState/Id": (ids[target], node),
        }
        if found is not None:
            found_fields["Transition"] = (ua.LocalizedText(found.name), text)
            found_fields["Transition/Id"] = (type_node(found.number), node)
        return found_fields

    async def emit(self, content: EventContent) -> None:
        """Send an event to subscribers of the server, the vision system, or its state machine."""
        number, message, severity, own = content
        now = datetime.now(UTC)
        event = CellEvent()
        kinds = ua.VariantType
        standard: dict[str, tuple[object, ua.VariantType]] = {
            "EventId": (uuid.uuid4().bytes, kinds.ByteString),
            "EventType": (type_node(number), kinds.NodeId),
            "SourceNode": (in_cell(SYSTEM), kinds.NodeId),
            "SourceName": (self._cell, kinds.String),
            "Time": (now, kinds.DateTime),
            "ReceiveTime": (now, kinds.DateTime),
            "Message": (ua.LocalizedText(message), kinds.LocalizedText),
            "Severity": (severity, kinds.UInt16),
        }
        for name, (value, kind) in {**standard, **own}.items():
            event.add_property(name, value, kind)
        for source in (base(ua.ObjectIds.Server), in_cell(SYSTEM), in_cell(MACHINE)):
            event.emitting_node = source
            try:
                await self._server.subscription_service.trigger_event(event)
            except Exception as error:  # noqa: BLE001  # one client's filter must not silence the others
                self._log.warning("opcua: an event did not reach all clients: %s", type(error).__name__)


def _result_fields(data: ResultDataType) -> dict[str, tuple[object, ua.VariantType]]:
    return {
        field.name: (
            getattr(data, field.name),
            RESULT_KINDS.get(field.name, ua.VariantType.ExtensionObject),
        )
        for field in fields(data)
        if field.name not in ("Encoding", "HasTransferableDataOnFile")
    }


def transition_cause(picture: RegisterPicture, to: Automatic | None) -> str:
    """Suffix in the name of the current transition, which the specification names by its cause."""
    if picture.values["COMMAND"] == CommandKind.CHANGE_JOB:
        return "Recipe"
    is_called = to is Automatic.SINGLE_EXECUTION and picture.values["LAST_SEQ"] == picture.called
    return "" if is_called else "Auto"
