"""Methods for clients: each becomes a write to the registers, or is answered from the newest picture.

Methods that a cell does not support answer BadNotSupported. `Error` is 0, or minus the NACK_REASON of the
handshake; below -100 it is minus a status of the line protocol for robots (OPC 40100-1: values below 0 are
the application's own).
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Protocol, TypeAlias, TypeVar

from asyncua import ua

from edged.adapters.opcua.nodes import MACHINE, SYSTEM, Nodes, argument, base, in_cell
from edged.adapters.opcua.picture import RegisterPicture, job_name
from edged.adapters.opcua.session import OpcUaSession, Server, caller
from edged.adapters.opcua.space import AUTOMATIC, HANDSHAKE, RECIPES, Space, own_name
from edged.adapters.opcua.state import Top, vision_state
from edged.adapters.opcua.structures import (
    JobIdDataType,
    RecipeIdInternalDataType,
    ResultDataType,
    structure,
    text_of,
)
from edged.domain.events import CommandKind
from edged.plc.answers import NackReason
from edged.plc.lines import LineStatus
from edged.plc.registers import INT32_MAX, UINT16_MAX, Number

UNKNOWN_RESULT, UNKNOWN_RECIPE = -int(LineStatus.NOT_VALID), -int(NackReason.REFUSED)
NOT_SUPPORTED = ua.StatusCode(ua.StatusCodes.BadNotSupported)
DENIED = ua.StatusCode(ua.StatusCodes.BadUserAccessDenied)
INVALID = ua.StatusCode(ua.StatusCodes.BadInvalidArgument)
MISSING = ua.StatusCode(ua.StatusCodes.BadArgumentsMissing)
WRONG_STATE = ua.StatusCode(ua.StatusCodes.BadInvalidState)

T = TypeVar("T")
MethodAnswer: TypeAlias = Any
"""Output arguments (`ua.Variant`), or a `ua.StatusCode`."""
Handler = Callable[..., Awaitable[MethodAnswer]]


class CommandWriter(Protocol):
    """Writes to the cell's handshake, on the cell's event loop, where each session is a client of its own."""

    async def command(
        self, session: ua.NodeId, values: Mapping[str, Number]
    ) -> tuple[int, int, RegisterPicture]:
        """Write a command; return its sequence, 0 or minus the NACK_REASON, and the registers after it."""

    async def write(self, session: ua.NodeId, values: Mapping[str, Number]) -> int:
        """Write other words of the command block; return 0 or minus the NACK_REASON."""


class Methods:
    """The methods of one cell."""

    def __init__(self, server: Server, space: Space, handshake: CommandWriter) -> None:
        self._server = server
        self._space = space
        self._handshake = handshake

    def install(self) -> None:
        """Bind every method of the address space."""
        self._build_handshake()
        meanings: dict[str, tuple[Handler, int]] = {
            f"{MACHINE}.SelectModeAutomatic": (self._select_automatic, 0),
            f"{AUTOMATIC}.StartSingleJob": (self._start_single_job, 5),
            f"{SYSTEM}.RecipeManagement.PrepareRecipe": (self._prepare_recipe, 2),
            f"{SYSTEM}.RecipeManagement.GetRecipeListFiltered": (self._recipes, 6),
            f"{SYSTEM}.ResultManagement.GetResultById": (self._result_by_id, 2),
            f"{SYSTEM}.ResultManagement.GetResultComponentsById": (self._result_components, 2),
            f"{SYSTEM}.ResultManagement.GetResultListFiltered": (self._results, 12),
            f"{HANDSHAKE}.Command": (self._command, 4),
            f"{HANDSHAKE}.Acknowledge": (self._acknowledge, 1),
            f"{HANDSHAKE}.Release": (self._release, 0),
        }
        for path in self._space.instances.methods:
            handler, count = meanings.get(path, (_unsupported, -1))
            self._bind(path, handler, count)
        self._space.recipe_added = self._bind_recipe

    def _bind(self, path: str, handler: Handler, count: int) -> None:
        async def run(_object: ua.NodeId, *arguments: ua.Variant) -> MethodAnswer:
            if count >= 0 and len(arguments) != count:
                return MISSING if len(arguments) < count else INVALID
            return await handler(*(argument.Value for argument in arguments))

        self._server.isession.add_method_callback(in_cell(path), run)

    def _bind_recipe(self, place: str) -> None:
        name = place.removeprefix(f"{RECIPES}.")

        async def prepare() -> MethodAnswer:
            answer = await self._prepare(self._space.job_number(RecipeIdInternalDataType(Id=ua.String(name))))
            return answer if isinstance(answer, ua.StatusCode) else answer[1:]

        self._bind(f"{place}.Prepare", prepare, 0)
        self._bind(f"{place}.Unprepare", _unsupported, -1)

    def _build_handshake(self) -> None:
        nodes, methods = Nodes(self._server), self._space.instances.methods
        node = nodes.object(
            HANDSHAKE, own_name(HANDSHAKE), in_cell(SYSTEM), base(ua.ObjectIds.BaseObjectType)
        )
        u16, double, error = base(5), base(11), argument("Error", base(6))
        sequence = argument("Sequence", u16)
        signatures = {
            "Command": (
                [
                    argument("Command", u16),
                    argument("Job", u16),
                    argument("Flange", double, is_array=True),
                    argument("TimeoutMs", u16),
                ],
                [sequence, error],
            ),
            "Acknowledge": ([sequence], [error]),
            "Release": ([], [error]),
        }
        for name, (inputs, outputs) in signatures.items():
            path = f"{HANDSHAKE}.{name}"
            methods[path] = nodes.method(path, own_name(name), node, inputs, outputs)

    # --- commands ----------------------------------------------------------------------------

    async def _start_single_job(
        self, meas: object, part: object, recipe: object, product: object, _parameters: object
    ) -> MethodAnswer:
        number = self._space.job_number(recipe)
        if number is None:
            return [structure(JobIdDataType()), _error(UNKNOWN_RECIPE)]
        picture = self._space.picture
        if picture is None or vision_state(picture.values, free_running=False).top is not Top.OPERATIONAL:
            return WRONG_STATE if _commanding_session() is not None else DENIED
        ran = await self._run({"COMMAND": CommandKind.LOCATE, "JOB": number})
        if isinstance(ran, ua.StatusCode):
            return ran
        sequence, error, after = ran
        if error:
            return [structure(JobIdDataType()), _error(error)]
        name = job_name(int(after.values["START_EPOCH"]), sequence)
        self._space.remember(name, (meas, part, recipe, product))
        return [structure(JobIdDataType(ua.String(name))), _error(0)]

    async def _command(self, kind: object, job: object, flange: object, timeout_ms: object) -> MethodAnswer:
        asked = (kind, job, timeout_ms)
        numbers = [number for number in asked if isinstance(number, int) and 0 <= number <= UINT16_MAX]
        given = flange if isinstance(flange, list) else []
        pose = [number for number in given if isinstance(number, float) and abs(number) * 1000 < INT32_MAX]
        if len(numbers) != len(asked) or len(pose) != len(given) or len(pose) not in (0, 6):
            return INVALID
        words: dict[str, Number] = {
            **dict(zip(("COMMAND", "JOB", "TIMEOUT"), numbers, strict=True)),
            **{
                f"FLANGE_{axis}": round(mm_or_deg * 1000)
                for axis, mm_or_deg in zip("XYZABC", pose, strict=False)
            },
        }
        ran = await self._run(words)
        if isinstance(ran, ua.StatusCode):
            return ran
        return [ua.Variant(ran[0], ua.VariantType.UInt16), _error(ran[1])]

    async def _acknowledge(self, sequence: object) -> MethodAnswer:
        if not isinstance(sequence, int) or not 0 <= sequence <= UINT16_MAX:
            return INVALID
        return await self._write({"ACK_SEQ": sequence})

    async def _release(self) -> MethodAnswer:
        return await self._write({"OPTIONS": 1})

    async def _run(self, words: Mapping[str, Number]) -> tuple[int, int, RegisterPicture] | ua.StatusCode:
        session = _commanding_session()
        return DENIED if session is None else await self._handshake.command(session.session_id, words)

    async def _write(self, words: Mapping[str, Number]) -> MethodAnswer:
        session = _commanding_session()
        return DENIED if session is None else [_error(await self._handshake.write(session.session_id, words))]

    async def _select_automatic(self) -> MethodAnswer:
        if _commanding_session() is None:
            return DENIED
        picture = self._space.picture
        if picture is None or vision_state(picture.values, free_running=False).top is not Top.OPERATIONAL:
            return WRONG_STATE
        return [_error(0)]  # a cell has no other mode

    # --- recipes -----------------------------------------------------------------------------

    async def _prepare_recipe(self, external: object, internal: object) -> MethodAnswer:
        recipe = internal if text_of(internal) else external
        return await self._prepare(self._space.job_number(recipe) if text_of(recipe) else None)

    async def _prepare(self, number: int | None) -> MethodAnswer:
        """Return InternalIdOut, IsCompleted and Error; the event RecipePrepared announces the completion."""
        picture = self._space.picture
        if _commanding_session() is None:
            return DENIED
        if number is None or picture is None:
            return _prepared("", done=False, error=UNKNOWN_RECIPE)
        name = next((name for other, name in picture.jobs if other == number), "")
        if picture.values["ACTIVE_JOB"] == number:
            return _prepared(name, done=True, error=0)
        ran = await self._run({"COMMAND": CommandKind.CHANGE_JOB, "JOB": number})
        return ran if isinstance(ran, ua.StatusCode) else _prepared(name, done=False, error=ran[1])

    async def _recipes(
        self,
        external: object,
        _product: object,
        prepared: object,
        most: object,
        start: object,
        _timeout: object,
    ) -> MethodAnswer:
        picture = self._space.picture
        jobs = picture.jobs if picture is not None else ()
        active = picture.values["ACTIVE_JOB"] if picture is not None else 0
        wanted = int(prepared) if isinstance(prepared, int) else 2  # TriStateBoolean: 2 is "don't care"
        found = [
            RecipeIdInternalDataType(Id=ua.String(name))
            for number, name in jobs
            if text_of(external) in ("", name, str(number)) and wanted in (2, int(number == active))
        ]
        some, is_complete = _page(found, most, start)
        return [
            ua.Variant(is_complete, ua.VariantType.Boolean),
            ua.Variant(len(some), ua.VariantType.UInt32),
            ua.Variant(0, ua.VariantType.UInt32),
            ua.Variant(some, ua.VariantType.ExtensionObject, is_array=True),
            _error(0),
        ]

    # --- results -----------------------------------------------------------------------------

    def _current(self) -> ResultDataType | None:
        """The result on display; None once it has expired."""
        picture = self._space.picture
        if picture is None or picture.result is None or self._space.is_overdue:
            return None
        return self._space.result_data(picture.result)

    async def _result_by_id(self, identifier: object, _timeout: object) -> MethodAnswer:
        data = self._current()
        if data is None or text_of(data.ResultId) != text_of(identifier):
            return [_handle(), structure(ResultDataType()), _error(UNKNOWN_RESULT)]
        return [_handle(), structure(data), _error(0)]

    async def _result_components(self, identifier: object, _timeout: object) -> MethodAnswer:
        data = self._current()
        is_it = data is not None and text_of(data.ResultId) == text_of(identifier)
        found = data if data is not None and is_it else ResultDataType()
        boolean, none = ua.VariantType.Boolean, ua.Variant(None)
        return [
            ua.Variant(False, boolean),
            _handle(),
            ua.Variant(found.IsPartial, boolean),
            ua.Variant(bool(found.IsSimulated), boolean),
            ua.Variant(found.ResultState, ua.VariantType.Int32),
            *(
                none if value is None else structure(value)
                for value in (
                    found.MeasId,
                    found.PartId,
                    found.ExternalRecipeId,
                    found.InternalRecipeId,
                    found.ProductId,
                    found.ExternalConfigurationId,
                    found.InternalConfigurationId,
                    found.JobId,
                )
            ),
            ua.Variant(found.CreationTime, ua.VariantType.DateTime),
            none if found.ProcessingTimes is None else structure(found.ProcessingTimes),
            ua.Variant(found.ResultContent or [], ua.VariantType.Variant, is_array=True),
            _error(0 if is_it else UNKNOWN_RESULT),
        ]

    async def _results(self, state: object, *rest: object) -> MethodAnswer:
        *filters, most, start, _timeout = rest
        data = self._current()
        found = []
        if data is not None and state in (0, None, data.ResultState):
            fields = (
                data.MeasId,
                data.PartId,
                data.ExternalRecipeId,
                data.InternalRecipeId,
                data.ExternalConfigurationId,
                data.InternalConfigurationId,
                data.ProductId,
                data.JobId,
            )
            pairs = zip(filters, fields, strict=True)
            found = [data] if all(text_of(wanted) in ("", text_of(field)) for wanted, field in pairs) else []
        some, is_complete = _page(found, most, start)
        return [
            ua.Variant(is_complete, ua.VariantType.Boolean),
            ua.Variant(len(some), ua.VariantType.UInt32),
            _handle(),
            ua.Variant(some, ua.VariantType.ExtensionObject, is_array=True),
            _error(0),
        ]


async def _unsupported(*_arguments: object) -> MethodAnswer:
    return NOT_SUPPORTED


def _commanding_session() -> OpcUaSession | None:
    """The calling session, if it may command; else None."""
    session = caller.get()
    return session if session is not None and session.may_command else None


def _error(number: int) -> ua.Variant:
    return ua.Variant(number, ua.VariantType.Int32)


def _handle() -> ua.Variant:
    """A handle of 0: there is nothing for the client to release."""
    return ua.Variant(0, ua.VariantType.UInt32)


def _prepared(name: str, *, done: bool, error: int) -> MethodAnswer:
    return [
        structure(RecipeIdInternalDataType(Id=ua.String(name))),
        ua.Variant(done, ua.VariantType.Boolean),
        _error(error),
    ]


def _page(found: list[T], most: object, start: object) -> tuple[list[T], bool]:
    first = start if isinstance(start, int) else 0
    count = most if isinstance(most, int) and most > 0 else len(found)
    return found[first : first + count], first + count >= len(found)


NOT_YOUR_TURN = -int(LineStatus.NOT_YOUR_TURN)
"""Error while another client holds the right to write."""
