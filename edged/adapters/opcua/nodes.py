"""Nodes for asyncua's address space, added without its slow client calls: a cell has a thousand of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from asyncua import ua
from asyncua.server.internal_server import InternalServer

from edged.errors import ListenError

CELL, VISION = 3, 2
"""Indices of the namespaces; 0 is OPC UA's own and 1 the application's."""
VISION_URI = "http://opcfoundation.org/UA/MachineVision"
CELL_URI = "urn:edged:cell"
SYSTEM = "VisionSystem"
MACHINE = f"{SYSTEM}.VisionStateMachine"
"""Paths of the vision system and its state machine in the cell's namespace."""

HAS_COMPONENT, HAS_PROPERTY = 47, 46
PROPERTY_TYPE, DATA_VARIABLE_TYPE = 68, 63


def base(number: int) -> ua.NodeId:
    """NodeId in OPC UA's own namespace."""
    return ua.NodeId(number, 0)


def in_cell(path: str) -> ua.NodeId:
    """NodeId in the cell's namespace; ids are paths, so they stay the same after a restart."""
    return ua.NodeId(path, CELL)


class Nodes:
    """Adds nodes to a server's address space."""

    def __init__(self, server: InternalServer) -> None:
        self._server = server

    def add(
        self,
        node: ua.NodeId,
        name: ua.QualifiedName,
        parent: ua.NodeId,
        reference: ua.NodeId,
        node_class: ua.NodeClass,
        attributes: Any,
        type_definition: ua.NodeId | None = None,
    ) -> ua.NodeId:
        """Add a node of any class. Raises `ListenError` if it contradicts the address space: a bug."""
        attributes.DisplayName = ua.LocalizedText(name.Name)
        item = ua.AddNodesItem()
        item.RequestedNewNodeId, item.BrowseName = node, name
        item.ParentNodeId, item.ReferenceTypeId = parent, reference
        item.NodeClass, item.NodeAttributes = node_class, attributes
        if type_definition is not None:
            item.TypeDefinition = type_definition
        (result,) = self._server.node_mgt_service.add_nodes([item])
        if not result.StatusCode.is_good():
            raise ListenError(f"opcua: node {node}: {result.StatusCode.name}")
        return node

    def refer(self, references: Iterable[tuple[ua.NodeId, ua.NodeId, ua.NodeId]]) -> None:
        """Add references (source, type, target) in both directions, where both nodes exist."""
        items = []
        for source, kind, target in references:
            for start, end, forward in ((source, target, True), (target, source, False)):
                if start in self._server.aspace and end in self._server.aspace:
                    item = ua.AddReferencesItem()
                    item.SourceNodeId, item.TargetNodeId = start, end
                    item.ReferenceTypeId, item.IsForward = kind, forward
                    items.append(item)
        self._server.node_mgt_service.add_references(items)

    def remove(self, nodes: Sequence[ua.NodeId]) -> None:
        """Remove nodes and the references to them."""
        params = ua.DeleteNodesParameters()
        for node in nodes:
            item = ua.DeleteNodesItem()
            item.NodeId, item.DeleteTargetReferences = node, True
            params.NodesToDelete.append(item)
        self._server.node_mgt_service.delete_nodes(params)

    def object(
        self,
        path: str,
        name: ua.QualifiedName,
        parent: ua.NodeId,
        type_definition: ua.NodeId,
        *,
        events: bool = False,
    ) -> ua.NodeId:
        """Add an object of the cell. events : clients may subscribe to its events."""
        attributes = ua.ObjectAttributes()
        attributes.EventNotifier = 1 if events else 0
        reference = base(35 if parent == base(ua.ObjectIds.ObjectsFolder) else HAS_COMPONENT)
        return self.add(
            in_cell(path), name, parent, reference, ua.NodeClass.Object, attributes, type_definition
        )

    def variable(
        self,
        path: str,
        name: ua.QualifiedName,
        parent: ua.NodeId,
        attributes: ua.VariableAttributes,
        *,
        type_definition: ua.NodeId | None = None,
        is_property: bool = False,
    ) -> ua.NodeId:
        """Add a variable or property of the cell. attributes : from `variable_attributes`."""
        return self.add(
            in_cell(path),
            name,
            parent,
            base(HAS_PROPERTY if is_property else HAS_COMPONENT),
            ua.NodeClass.Variable,
            attributes,
            type_definition or base(PROPERTY_TYPE if is_property else DATA_VARIABLE_TYPE),
        )

    def method(
        self,
        path: str,
        name: ua.QualifiedName,
        parent: ua.NodeId,
        inputs: Sequence[ua.Argument],
        outputs: Sequence[ua.Argument],
    ) -> ua.NodeId:
        """Add a method of the cell with its arguments."""
        attributes = ua.MethodAttributes()
        attributes.Executable = attributes.UserExecutable = True
        node = self.add(in_cell(path), name, parent, base(HAS_COMPONENT), ua.NodeClass.Method, attributes)
        for what, arguments in (("InputArguments", inputs), ("OutputArguments", outputs)):
            if arguments:
                value = ua.Variant(list(arguments), ua.VariantType.ExtensionObject)
                self.variable(
                    f"{path}.{what}",
                    ua.QualifiedName(what, 0),
                    node,
                    variable_attributes(base(ua.ObjectIds.Argument), value, rank=1),
                    is_property=True,
                )
        return node


def variable_attributes(
    data_type: ua.NodeId, value: ua.Variant | None = None, *, rank: int = -1, description: str = ""
) -> ua.VariableAttributes:
    """Attributes of a read-only variable. value None: not yet known."""
    attributes = ua.VariableAttributes()
    attributes.Description = ua.LocalizedText(description)
    attributes.DataType, attributes.ValueRank = data_type, rank
    attributes.AccessLevel = attributes.UserAccessLevel = ua.AccessLevel.CurrentRead.mask
    attributes.Value = value or ua.Variant(None, ua.VariantType.Null)
    if rank == 1:
        attributes.ArrayDimensions = [0]
    return attributes


def argument(name: str, data_type: ua.NodeId, *, is_array: bool = False) -> ua.Argument:
    """One argument of a method."""
    found = ua.Argument()
    found.Name, found.DataType, found.ValueRank = name, data_type, 1 if is_array else -1
    if is_array:
        found.ArrayDimensions = [0]
    return found
