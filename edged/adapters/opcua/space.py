"""The address space of a cell: a vision system of OPC 40100-1, and every register as a variable in it.

`show` replaces a picture with the next: first all values, then notifications to subscriptions, then events.
Nothing else runs between the first and the last value, so no read mixes two results. A coordinate that may no
longer be used has no value and the status BadNoData, from the same moment on as its flag.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from typing import Any

from asyncua import ua

from edged.adapters.opcua.events import CellEvents
from edged.adapters.opcua.model import Instances, Model, add_types, type_node
from edged.adapters.opcua.nodes import CELL_URI, MACHINE, SYSTEM, Nodes, base, in_cell, variable_attributes
from edged.adapters.opcua.picture import RegisterPicture, ResultRecord
from edged.adapters.opcua.session import Server
from edged.adapters.opcua.settings import OpcUaSettings
from edged.adapters.opcua.state import Automatic, Top, VisionState, vision_state
from edged.adapters.opcua.structures import (
    EPOCH,
    RESULT_KINDS,
    ConfigurationIdDataType,
    JobIdDataType,
    MeasIdDataType,
    PartIdDataType,
    ProcessingTimesDataType,
    ProductIdDataType,
    RecipeIdExternalDataType,
    RecipeIdInternalDataType,
    ResultDataType,
    ResultIdDataType,
    structure,
    text_of,
)
from edged.domain.events import Snapshot
from edged.domain.measurement import Status
from edged.plc import registers as reg

REGISTERS, HANDSHAKE = "Registers", "Handshake"
AUTOMATIC = f"{MACHINE}.AutomaticModeStateMachine"
RECIPES = f"{SYSTEM}.RecipeManagement.Recipes"
LATEST = f"{SYSTEM}.ResultManagement.Results.Latest"
OPTIONAL = frozenset(
    {
        "AutomaticModeStateMachine",
        "SelectModeAutomatic",
        "RecipeManagement",
        "Recipes",
        "ResultManagement",
        "Results",
        "ExternalId",
        "IsSimulated",
        "ProcessingTimes",
        "ResultContent",
        "MeasId",
        "PartId",
    }
)
"""Optional parts of the specification that a cell provides."""
LASTING_BLOCKS = (
    *(reg.CONSTANTS, reg.COMMAND, reg.STATUS, reg.COUNTERS),
    *(*reg.JOBS, reg.REFERENCE_MARKS, reg.ACCEPTANCE, reg.ROBOT_MAP),
)
"""Blocks that do not expire; every other block belongs to a result and is hidden when that expires."""
VARIANTS = {
    reg.Kind.U16: ua.VariantType.UInt16,
    reg.Kind.I32: ua.VariantType.Int32,
    reg.Kind.U32: ua.VariantType.UInt32,
    reg.Kind.U64: ua.VariantType.UInt64,
    reg.Kind.F32: ua.VariantType.Float,
}
UNITS = {"µm": "4H", "mm": "MMT", "°": "DD", "ms": "C26", "µs": "B98", "ns": "C45", "µrad": "B97"}
"""Codes of UNECE Recommendation 20; as a UnitId their characters form a number (OPC 10000-8, 5.6.3)."""
BAD = ua.StatusCode(ua.StatusCodes.BadNoData)
INACTIVE = ua.StatusCode(ua.StatusCodes.BadStateNotActive)
GOOD = ua.StatusCode()
MAX_ASKED = 64

COMPLETED, FAILED = 1, 4  # ResultStateDataType, OPC 40100-1, table 153

Written = tuple[ua.NodeId, object, ua.StatusCode, ua.VariantType]
"""Value, status and type of a variable."""
Asked = tuple[object, object, object, object]  # MeasId, PartId, RecipeId, ProductId of StartSingleJob


def own_name(name: str) -> ua.QualifiedName:
    """Browse name in the cell's namespace."""
    return ua.QualifiedName(name, 3)


class Space:
    """The nodes of one cell. moment_s : monotonic, the clock of `RegisterPicture.valid_until_s`."""

    def __init__(
        self, server: Server, settings: OpcUaSettings, model: Model, moment_s: Callable[[], float]
    ) -> None:
        self._server = server
        self._settings = settings
        self._model = model
        self._moment_s = moment_s
        self._nodes = Nodes(server)
        self.instances = Instances(self._nodes, model)
        self._registers: dict[int, tuple[reg.Register, ua.NodeId, bool]] = {}
        self._shown: dict[ua.NodeId, tuple[object, int]] = {}
        self._modified: dict[str, datetime] = {}
        self._asked: dict[str, Asked] = {}
        self._written: tuple[Snapshot, str] | None = None  # cache: its content is formatted once
        self._events = CellEvents(server, settings.cell, model)
        self.picture: RegisterPicture | None = None
        self._expired = True
        self._state = VisionState(Top.PREOPERATIONAL, None)
        self.recipe_added: Callable[[str], None] = lambda _path: None

    # --- building ----------------------------------------------------------------------------

    def build(self) -> None:
        """Add types and objects."""
        add_types(self._nodes, self._model)
        objects = base(ua.ObjectIds.ObjectsFolder)
        system = self.instances.build(
            1003, SYSTEM, own_name(self._settings.cell), objects, OPTIONAL, events=True
        )
        self._notify(in_cell(MACHINE))
        latest = self._nodes.variable(
            LATEST,
            own_name("Latest"),
            in_cell(f"{SYSTEM}.ResultManagement.Results"),
            variable_attributes(type_node(3006)),
            type_definition=type_node(2002),
        )
        self.instances.variables[LATEST] = latest
        self.instances.fill(2002, LATEST, latest, OPTIONAL)
        self._build_registers(system)
        self._build_metadata()

    def _build_metadata(self) -> None:
        """Describe the cell's namespace, as the table does for OPC 40100-1 (OPC 10000-5, 6.3.13)."""
        node = self._nodes.object(
            "Namespace", own_name(CELL_URI), base(ua.ObjectIds.Server_Namespaces), base(11616)
        )
        kinds = ua.VariantType
        for name, data_type, kind, value in (
            ("NamespaceUri", 12, kinds.String, CELL_URI),
            ("NamespaceVersion", 12, kinds.String, str(reg.MAP_VERSION)),
            ("NamespacePublicationDate", 13, kinds.DateTime, reg.MAP_PUBLISHED),
            ("IsNamespaceSubset", 1, kinds.Boolean, False),
            ("StaticNodeIdTypes", 256, kinds.Int32, [ua.Int32(ua.IdType.String)]),
            ("StaticNumericNodeIdRange", 291, kinds.String, []),
            ("StaticStringNodeIdPattern", 12, kinds.String, f"{REGISTERS}.%"),
        ):
            is_array = isinstance(value, list)
            attributes = variable_attributes(
                base(data_type), ua.Variant(value, kind, is_array=is_array), rank=1 if is_array else -1
            )
            place, own = f"Namespace.{name}", ua.QualifiedName(name, 0)
            self._nodes.variable(place, own, node, attributes, is_property=True)

    def _notify(self, node: ua.NodeId) -> None:
        attribute = self._server.aspace[node].attributes[ua.AttributeIds.EventNotifier]
        attribute.value = ua.DataValue(ua.Variant(1, ua.VariantType.Byte))

    def _build_registers(self, system: ua.NodeId) -> None:
        folder = self._nodes.object(REGISTERS, own_name(REGISTERS), system, base(61))
        for block in reg.BLOCKS:
            path = f"{REGISTERS}.{block.name}"
            parent = self._nodes.object(path, own_name(block.name), folder, base(61))
            for register in block.registers:
                place = f"{path}.{register.name}"
                node = self._nodes.variable(
                    place,
                    own_name(register.name),
                    parent,
                    variable_attributes(base(VARIANTS[register.kind].value), description=register.help),
                )
                self._registers[register.address] = (register, node, block not in LASTING_BLOCKS)
                if register.unit and register.unit != "bits":
                    self._nodes.variable(
                        f"{place}.EngineeringUnits",
                        ua.QualifiedName("EngineeringUnits", 0),
                        node,
                        variable_attributes(
                            base(ua.ObjectIds.EUInformation),
                            ua.Variant(unit_of(register.unit), ua.VariantType.ExtensionObject),
                        ),
                        is_property=True,
                    )

    # --- showing -----------------------------------------------------------------------------

    async def show(self, picture: RegisterPicture) -> None:
        """Replace the picture: write all values, then emit the events of the change."""
        before, self.picture, self._expired = self.picture, picture, False
        if before is None or before.jobs != picture.jobs:
            self._exchange_recipes(picture)
        state, self._state = (
            self._state,
            vision_state(picture.values, free_running=self._settings.free_running),
        )
        if self._moment_s() >= picture.valid_until_s > 0.0:
            await self.expire()  # it expired on the way here
        else:
            await self._write([*self._register_values(picture), *self._other_values(picture)])
        for event in self._events.of_change(before, picture, state, self._state, self.result_data):
            await self._events.emit(event)

    async def expire(self) -> None:
        """Hide an expired result without waiting for the next picture."""
        if self._expired or self.picture is None:
            return
        self._expired = True
        hidden: list[Written] = [
            (node, None, BAD, VARIANTS[register.kind])
            for register, node, is_result in self._registers.values()
            if is_result or register.name == "STATUS_BITS"
        ]
        await self._write([*hidden, *self._result_values(None)])

    @property
    def is_overdue(self) -> bool:
        """Whether a coordinate is still shown that may no longer be used."""
        picture = self.picture
        return not self._expired and picture is not None and 0.0 < picture.valid_until_s <= self._moment_s()

    async def _write(self, values: list[Written]) -> None:
        now = datetime.now(UTC)
        changed = []
        for node, value, status, kind in values:
            new = (value, status.value)
            if self._shown.get(node) == new:
                continue
            self._shown[node] = new
            variant = ua.Variant(None, ua.VariantType.Null) if status.is_bad() else ua.Variant(value, kind)
            data = ua.DataValue(variant, status, SourceTimestamp=now, ServerTimestamp=now)
            attribute = self._server.aspace[node].attributes[ua.AttributeIds.Value]
            attribute.value = data
            changed.append((attribute, data))
        for attribute, data in changed:
            for handle, tell in list(attribute.datachange_callbacks.items()):
                await tell(handle, data)

    def _register_values(self, picture: RegisterPicture) -> Iterator[Written]:
        for address, (register, node, is_result) in self._registers.items():
            value = picture.numbers.get(address, 0)  # empty rows of the job table are left out
            unknown = is_result and is_unknown(register, value)
            yield node, None if unknown else value, BAD if unknown else GOOD, VARIANTS[register.kind]

    def _other_values(self, picture: RegisterPicture) -> Iterator[Written]:
        yield from self._state_values(MACHINE, self._state.top)
        yield from self._state_values(AUTOMATIC, self._state.automatic)
        for number, name in picture.jobs:
            is_active = number == picture.values["ACTIVE_JOB"]
            place = f"{RECIPES}.{name}"
            variables = self.instances.variables
            yield variables[f"{place}.IsPrepared"], is_active, GOOD, ua.VariantType.Boolean
        yield from self._result_values(picture.result)

    def _state_values(self, path: str, state: Top | Automatic | None) -> Iterator[Written]:
        number, node, name = (0, 0, "") if state is None else state.value
        status = INACTIVE if state is None else GOOD
        place, variables = f"{path}.CurrentState", self.instances.variables
        yield variables[place], ua.LocalizedText(name), status, ua.VariantType.LocalizedText
        yield variables[f"{place}.Id"], type_node(node), status, ua.VariantType.NodeId
        yield variables[f"{place}.Number"], number, status, ua.VariantType.UInt32

    def _result_values(self, record: ResultRecord | None) -> Iterator[Written]:
        status = BAD if record is None else GOOD
        data = ResultDataType() if record is None else self.result_data(record)
        variables = self.instances.variables
        yield variables[LATEST], data, status, ua.VariantType.ExtensionObject
        for path, node in variables.items():
            if path.startswith(f"{LATEST}."):
                name = path.removeprefix(f"{LATEST}.")
                value = getattr(data, name)
                absent = record is None or value is None
                yield (
                    node,
                    value,
                    BAD if absent else GOOD,
                    RESULT_KINDS.get(name, ua.VariantType.ExtensionObject),
                )

    # --- recipes and results -----------------------------------------------------------------

    def _exchange_recipes(self, picture: RegisterPicture) -> None:
        """Add objects for new jobs and remove those of deleted ones."""
        wanted = {name for _, name in picture.jobs}
        variables, methods = self.instances.variables, self.instances.methods
        for name in [name for name in self._modified if name not in wanted]:
            place = f"{RECIPES}.{name}"
            gone = [path for path in (*variables, *methods) if path.startswith(f"{place}.")]
            arguments = [f"{path}.OutputArguments" for path in gone if path in methods]
            self._nodes.remove([in_cell(path) for path in (*arguments, *gone, place)])
            for path in gone:
                self._shown.pop(in_cell(path), None)
                variables.pop(path, None)
                methods.pop(path, None)
            del self._modified[name]
        for number, name in picture.jobs:
            if name not in self._modified:
                self._add_recipe(number, name)

    def _add_recipe(self, number: int, name: str) -> None:
        place = f"{RECIPES}.{name}"
        self._modified[name] = now = datetime.now(UTC)
        self.instances.build(1002, place, own_name(name), in_cell(RECIPES), OPTIONAL)
        values: dict[str, ua.Variant] = {
            "InternalId": structure(RecipeIdInternalDataType(Id=ua.String(name))),
            "ExternalId": structure(RecipeIdExternalDataType(Id=ua.String(str(number)))),
            "LastModified": ua.Variant(now, ua.VariantType.DateTime),
        }
        for key, value in values.items():
            node = self.instances.variables[f"{place}.{key}"]
            self._server.aspace[node].attributes[ua.AttributeIds.Value].value = ua.DataValue(value)
        self.recipe_added(place)

    def job_number(self, recipe: object) -> int | None:
        """Job number of a recipe's id, which is a name or a number; 0 for an empty id, None if unknown."""
        text = text_of(recipe)
        if not text:
            return 0
        jobs = self.picture.jobs if self.picture is not None else ()
        return next((number for number, name in jobs if text in (name, str(number))), None)

    def remember(self, job: str, asked: Asked) -> None:
        """Remember the ids that a client gave for an execution, to repeat them in its result."""
        while len(self._asked) >= MAX_ASKED:
            del self._asked[next(iter(self._asked))]
        self._asked[job] = asked

    def result_data(self, record: ResultRecord) -> ResultDataType:
        """The result in the specification's structure."""
        meas, part, recipe, product = self._asked.get(record.name, (None,) * 4)
        snapshot, content = record.snapshot, self._content(record)
        published = _time(snapshot.published_ns)
        return ResultDataType(
            ResultId=ResultIdDataType(ua.String(record.name)),
            HasTransferableDataOnFile=_boolean(value=False),
            IsPartial=_boolean(value=False),
            IsSimulated=_boolean(value=snapshot.simulated),
            ResultState=ua.Int32(FAILED if snapshot.status is Status.CAPTURE_FAULT else COMPLETED),
            MeasId=meas if isinstance(meas, MeasIdDataType) else None,
            PartId=part if isinstance(part, PartIdDataType) else None,
            ExternalRecipeId=recipe if isinstance(recipe, RecipeIdExternalDataType) else None,
            InternalRecipeId=RecipeIdInternalDataType(Id=ua.String(snapshot.job)),
            ProductId=product if isinstance(product, ProductIdDataType) else None,
            InternalConfigurationId=ConfigurationIdDataType(Id=ua.String(snapshot.fingerprint)),
            JobId=JobIdDataType(ua.String(record.name)),
            CreationTime=published,
            ProcessingTimes=ProcessingTimesDataType(
                _time(snapshot.exposed_ns) if snapshot.exposed_ns else published,
                published,
                None,
                ua.Double(sum(snapshot.timing_ms.values())),
            ),
            ResultContent=[ua.Variant(content, ua.VariantType.String)] if content else None,
        )

    def _content(self, record: ResultRecord) -> str:
        if self._written is None or self._written[0] is not record.snapshot:
            self._written = record.snapshot, record.content()
        return "" if record.is_silent else self._written[1]


def is_unknown(register: reg.Register, value: reg.Number) -> bool:
    """Whether a register of a result holds the value that means "unknown"."""
    if register.kind is reg.Kind.I32:
        return value == reg.INT32_MIN
    if register.kind is reg.Kind.F32:
        return math.isnan(value)
    is_saturated = "SIGMA_" in register.name or register.name == "EPIPOLAR_ERROR"
    return is_saturated and value == reg.UINT16_MAX


def unit_of(unit: str) -> ua.EUInformation:
    """Unit of a register; only its text where UNECE has no code."""
    found = ua.EUInformation()
    found.NamespaceUri = "http://www.opcfoundation.org/UA/units/un/cefact"
    found.UnitId = int.from_bytes(UNITS[unit].encode(), "big") if unit in UNITS else -1
    found.DisplayName = found.Description = ua.LocalizedText(unit)
    return found


def _time(utc_ns: int) -> Any:
    return EPOCH + timedelta(microseconds=utc_ns / 1000)


def _boolean(*, value: bool) -> Any:
    """Pass a bool where asyncua's Boolean is expected, which type checkers do not accept."""
    return value
