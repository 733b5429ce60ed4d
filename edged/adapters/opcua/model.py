"""The types of OPC 40100-1, read from a table next to this module and added to an address space.

The table holds the content of the specification's tables: names, NodeIds, arguments, fields, numbers.
Instances are built from it, too: with all mandatory parts of a type and the requested optional ones.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from datetime import datetime
from importlib import resources
from typing import Any

from asyncua import ua

from edged.adapters.opcua.nodes import (
    HAS_PROPERTY,
    VISION,
    VISION_URI,
    Nodes,
    argument,
    base,
    variable_attributes,
)

STATE_MACHINES = frozenset({1017, 1021, 1026})
FINITE_STATE_VARIABLE_TYPE = 2760
SCALARS: dict[str, tuple[ua.VariantType, Callable[[str], Any]]] = {
    "0:1": (ua.VariantType.Boolean, lambda text: text == "true"),
    "0:7": (ua.VariantType.UInt32, int),
    "0:12": (ua.VariantType.String, str),
    "0:13": (ua.VariantType.DateTime, datetime.fromisoformat),
    "0:256": (ua.VariantType.Int32, lambda text: [int(text)]),
    "0:7594": (ua.VariantType.ExtensionObject, lambda text: [_named_value(*pair) for pair in pairs_of(text)]),
}
"""Variant type and parser of the table's values, by data type."""


@dataclass(frozen=True, slots=True)
class ModelRow:
    """A node of the table. parent, type_definition, data_type : "0:58", "1:1017"; "" without one."""

    number: int
    kind: str
    name: str
    parent: str
    reference: str
    type_definition: str
    data_type: str
    rank: str
    rule: str
    value: str


@dataclass(frozen=True, slots=True)
class Model:
    """The table: rows in their order, children by parent, references between them."""

    rows: tuple[ModelRow, ...]
    children: Mapping[str, tuple[ModelRow, ...]]
    references: tuple[tuple[str, str, str], ...]

    def encoding_of(self, number: int) -> ua.NodeId:
        """Id under which structures of a data type are sent in binary; null for other types."""
        for row in self.children.get(f"1:{number}", ()):
            if row.name == "0:Default Binary":
                return ua.NodeId(row.number, VISION)
        return ua.NodeId()


def read_model() -> Model:
    """Read the table in this package."""
    text = resources.files(__package__).joinpath("machinevision.tsv").read_text("utf-8")
    first, second = "\n".join(line for line in text.splitlines() if not line.startswith("#")).split("\n\n")
    rows = []
    for line in first.splitlines():
        number, *rest = line.split("\t")
        rows.append(ModelRow(int(number), *rest))
    children = defaultdict[str, list[ModelRow]](list)
    for row in rows:
        children[row.parent].append(row)
    references = [tuple(line.split("\t")) for line in second.splitlines()]
    return Model(
        tuple(rows),
        {parent: tuple(found) for parent, found in children.items()},
        tuple((source, kind, target) for source, kind, target in references),
    )


def node_of(text: str) -> ua.NodeId:
    """NodeId of a reference in the table, such as "0:58" or "1:1017"."""
    space, _, number = text.partition(":")
    return ua.NodeId(int(number), VISION if space == "1" else 0)


def name_of(text: str) -> ua.QualifiedName:
    """Browse name of a name in the table, where "0:" marks OPC UA's own namespace."""
    return ua.QualifiedName(text[2:], 0) if text.startswith("0:") else ua.QualifiedName(text, VISION)


def arguments_of(text: str) -> list[ua.Argument]:
    """Parse the arguments of a method in the table."""
    return [
        argument(name, node_of(kind), is_array=rank == ["1"])
        for name, kind, *rank in (part.split() for part in text.split(",") if part)
    ]


def pairs_of(text: str) -> list[tuple[str, int]]:
    """Parse the names and numbers of an enumeration in the table."""
    return [(name, int(number)) for name, _, number in (part.partition("=") for part in text.split(","))]


def _named_value(name: str, number: int) -> ua.EnumValueType:
    found = ua.EnumValueType()
    found.Value, found.DisplayName = ua.Int64(number), ua.LocalizedText(name)
    return found


def add_types(nodes: Nodes, model: Model) -> None:
    """Add every type of the specification."""
    pending = list(model.rows)
    known = {f"1:{row.number}" for row in model.rows}
    while pending:  # parents first
        waiting = {f"1:{row.number}" for row in pending}
        ready = [row for row in pending if row.parent not in known or row.parent not in waiting]
        for row in ready:
            _add_type_row(nodes, model, row)
        done = set(map(id, ready))
        pending = [row for row in pending if id(row) not in done]
    rules = {"M": 78, "O": 80, "OP": 11508, "MP": 11510}
    nodes.refer(
        [
            *((node_of(source), node_of(kind), node_of(target)) for source, kind, target in model.references),
            *(
                (node_of(f"1:{row.number}"), base(37), base(rules[row.rule]))
                for row in model.rows
                if row.rule
            ),
        ]
    )


def _add_type_row(nodes: Nodes, model: Model, row: ModelRow) -> None:
    is_abstract = row.value.endswith("abstract")
    attributes: Any
    match row.kind:
        case "O":
            attributes, kind = ua.ObjectAttributes(), ua.NodeClass.Object
            attributes.EventNotifier = 0
        case "V":
            rank = int(row.rank or -1)
            attributes = variable_attributes(node_of(row.data_type or "0:24"), _value_of(row), rank=rank)
            kind = ua.NodeClass.Variable
        case "M":
            attributes, kind = ua.MethodAttributes(), ua.NodeClass.Method
            attributes.Executable = attributes.UserExecutable = True
        case "OT":
            attributes, kind = ua.ObjectTypeAttributes(), ua.NodeClass.ObjectType
            attributes.IsAbstract = is_abstract
        case "VT":
            attributes, kind = ua.VariableTypeAttributes(), ua.NodeClass.VariableType
            attributes.DataType, attributes.ValueRank = node_of(row.data_type), -1
            attributes.IsAbstract = is_abstract
        case "DT":
            attributes, kind = ua.DataTypeAttributes(), ua.NodeClass.DataType
            attributes.IsAbstract = is_abstract
            attributes.DataTypeDefinition = _definition_of(row, model.encoding_of(row.number))
        case _:
            attributes, kind = ua.ReferenceTypeAttributes(), ua.NodeClass.ReferenceType
    nodes.add(
        ua.NodeId(row.number, VISION),
        ua.QualifiedName(VISION_URI, VISION) if row.name == VISION_URI else name_of(row.name),
        node_of(row.parent),
        base(int(row.reference)),
        kind,
        attributes,
        node_of(row.type_definition) if row.type_definition else None,
    )


def _value_of(row: ModelRow) -> ua.Variant | None:
    if row.data_type == "0:296":
        return ua.Variant(arguments_of(row.value), ua.VariantType.ExtensionObject)
    if row.value and row.data_type in SCALARS:
        kind, read = SCALARS[row.data_type]
        return ua.Variant(read(row.value), kind)
    return None


IDENTIFIER_FIELDS = "Id 1:3017,Version? 1:3017,Hash? 0:15,HashAlgorithm? 0:12,Description? 0:21"
"""Fields of BinaryIdBaseDataType, whose subtypes have no fields of their own."""


def _definition_of(row: ModelRow, encoding: ua.NodeId) -> Any:
    text = row.value.removesuffix("abstract").strip() or (IDENTIFIER_FIELDS if row.parent == "1:3019" else "")
    if "=" in text:
        enumeration = ua.EnumDefinition()
        for name, number in pairs_of(text):
            field = ua.EnumField()
            field.Name, field.Value, field.DisplayName = name, ua.Int64(number), ua.LocalizedText(name)
            enumeration.Fields.append(field)
        return enumeration
    if not text:
        return None
    structure = ua.StructureDefinition()
    structure.BaseDataType, structure.DefaultEncodingId = node_of(row.parent), encoding
    structure.StructureType = (
        ua.StructureType.StructureWithOptionalFields if "?" in text else ua.StructureType.Structure
    )
    for part in text.split(","):
        name, kind, *rank = part.split()
        found = ua.StructureField()
        found.Name, found.IsOptional = name.removesuffix("?"), name.endswith("?")
        found.DataType, found.ValueRank = node_of(kind), 1 if rank else -1
        structure.Fields.append(found)
    return structure


class Instances:
    """Builds objects of the cell from the types. methods, variables : ids of the nodes built, by path."""

    def __init__(self, nodes: Nodes, model: Model) -> None:
        self._nodes = nodes
        self._model = model
        self.methods: dict[str, ua.NodeId] = {}
        self.variables: dict[str, ua.NodeId] = {}

    def build(
        self,
        type_number: int,
        path: str,
        name: ua.QualifiedName,
        parent: ua.NodeId,
        optional: Collection[str] = (),
        *,
        events: bool = False,
    ) -> ua.NodeId:
        """Build an object of a type with all mandatory parts and the named optional ones."""
        node = self._nodes.object(path, name, parent, ua.NodeId(type_number, VISION), events=events)
        self.fill(type_number, path, node, optional)
        return node

    def fill(self, type_number: int, path: str, node: ua.NodeId, optional: Collection[str] = ()) -> None:
        """Add the parts of its type to a node."""
        if type_number in STATE_MACHINES:
            self._current_state(path, node)
        for row in self._model.children.get(f"1:{type_number}", ()):
            if row.rule == "M" or (row.rule == "O" and row.name in optional):
                self._part(row, path, node, optional)

    def _current_state(self, path: str, node: ua.NodeId) -> None:
        place = f"{path}.CurrentState"
        self.variables[place] = state = self._nodes.variable(
            place,
            ua.QualifiedName("CurrentState", 0),
            node,
            variable_attributes(base(ua.ObjectIds.LocalizedText)),
            type_definition=base(FINITE_STATE_VARIABLE_TYPE),
        )
        for name, kind in (("Id", ua.ObjectIds.NodeId), ("Number", ua.ObjectIds.UInt32)):
            self.variables[f"{place}.{name}"] = self._nodes.variable(
                f"{place}.{name}",
                ua.QualifiedName(name, 0),
                state,
                variable_attributes(base(kind)),
                is_property=True,
            )

    def _part(self, row: ModelRow, path: str, parent: ua.NodeId, optional: Collection[str]) -> None:
        name, place = name_of(row.name), f"{path}.{row.name.removeprefix('0:')}"
        if row.kind == "M":
            signature = {child.name: child.value for child in self._model.children.get(f"1:{row.number}", ())}
            self.methods[place] = self._nodes.method(
                place,
                name,
                parent,
                arguments_of(signature.get("0:InputArguments", "")),
                arguments_of(signature.get("0:OutputArguments", "")),
            )
        elif row.kind == "V":
            self.variables[place] = self._nodes.variable(
                place,
                name,
                parent,
                variable_attributes(node_of(row.data_type or "0:24"), rank=int(row.rank or -1)),
                type_definition=node_of(row.type_definition),
                is_property=row.reference == str(HAS_PROPERTY),
            )
        elif row.type_definition.startswith("1:"):
            self.build(int(row.type_definition[2:]), place, name, parent, optional)
        else:
            self._nodes.object(place, name, parent, node_of(row.type_definition))


def type_node(number: int) -> ua.NodeId:
    """NodeId of a type or state of the specification."""
    return ua.NodeId(number, VISION)
