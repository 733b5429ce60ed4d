"""A tree-walking interpreter for the structured text that edged writes, on the syntax tree of blark.

As strict as a compiler: unknown names, values that do not fit their type and mixed types are errors, so
that the source is checked for more than its syntax. It covers what `FB_EDGED` uses, not all of IEC 61131-3.
"""

from __future__ import annotations

import copy
import functools
import hashlib
import os
import pickle
import re
import sys
import time
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from blark import transform as ast
from blark.parse import parse_source_code

from helpers.robotwords import Declared
from helpers.waiting import LIMIT_S

PARSED = Path(__file__).parents[2] / ".pytest_cache" / "parsed"
LITERALS = {
    "ANY_INT": {"INT", "DINT", "UINT", "UDINT", "HW_ANY", "CONN_OUC"},
    "ANY_HEX": {"INT", "DINT", "UINT", "UDINT", "BYTE", "WORD", "DWORD"},
}
"""Types that a literal may have: a decimal number is no bit string (IEC 61131-3, 6.3.2 and table 10)."""
RANGES = {
    "INT": (-(2**15), 2**15 - 1),
    "DINT": (-(2**31), 2**31 - 1),
    "UINT": (0, 2**16 - 1),
    "UDINT": (0, 2**32 - 1),
    "BYTE": (0, 2**8 - 1),
    "WORD": (0, 2**16 - 1),
    "DWORD": (0, 2**32 - 1),
    "TIME": (0, 2**32 - 1),  # ms
    "HW_ANY": (0, 2**16 - 1),  # SIMATIC S7: a number of the hardware, of a connection
    "CONN_OUC": (0, 2**16 - 1),
}


@functools.cache
def parse(source: str) -> list[Any]:
    """Declarations of a source. Raises what blark reports about an error.

    Takes a quarter of a minute for `FB_EDGED`, so results are cached, and in a file for the other processes.
    """
    key = f"{version('blark')} {sys.version} {source}"
    kept = PARSED / hashlib.sha256(key.encode()).hexdigest()
    if kept.exists():
        return list(pickle.loads(kept.read_bytes()))
    parsed = parse_source_code(source)
    if parsed.exception is not None:
        raise parsed.exception
    items = list(parsed.transform().items)
    PARSED.mkdir(parents=True, exist_ok=True)
    new = kept.with_suffix(f".{os.getpid()}")
    new.write_bytes(pickle.dumps(items))
    new.replace(kept)
    return items


class Timer:
    """TON: Q rises when IN has been true for PT ms of the program's clock."""

    def __init__(self, clock_ms: Callable[[], float]) -> None:
        self._clock_ms = clock_ms
        self._since_ms: float | None = None
        self.fields: dict[str, tuple[Any, str]] = {"Q": (False, "BOOL")}

    def call(self, given: Mapping[str, tuple[Any, Kind]]) -> None:
        """Execute one call, with inputs and their types."""
        (raised, _), (limit_ms, _) = given["IN"], given["PT"]
        if not raised:
            self._since_ms = None
        elif self._since_ms is None:
            self._since_ms = self._clock_ms()
        is_over = self._since_ms is not None and self._clock_ms() - self._since_ms >= limit_ms
        self.fields["Q"] = (is_over, "BOOL")


class Foreign(Protocol):
    """A function block that is not in the source. fields : its outputs, each with its type."""

    fields: dict[str, tuple[Any, str]]

    def call(self, given: Mapping[str, tuple[Any, Kind]]) -> None:
        """Run it once."""
        ...


Kind = str | tuple[int, str]
"""Name of a type; for an array its length and the type of its elements."""


class Program:
    """Parsed source: makes instances of its function blocks.

    library : makes the PLC's own function blocks, by the name of their type.
    shared : names and types of global variables.
    """

    def __init__(
        self,
        source: str,
        clock_ms: Callable[[], float],
        library: Mapping[str, Callable[[], Foreign]] | None = None,
        shared: Mapping[str, str] | None = None,
    ) -> None:
        self.clock_ms = clock_ms
        self.declared = Declared("iec")
        self.library = {"TON": lambda: Timer(clock_ms), **(library or {})}
        self.types: dict[str, list[tuple[str, Kind]]] = {}
        self.functions: dict[str, ast.Function] = {}
        self.blocks: dict[str, ast.FunctionBlock] = {}
        for item in parse(source):
            self.declared(str(getattr(item, "declaration", item).name))
            if isinstance(item, ast.DataTypeDeclaration):
                self.types[str(item.declaration.name)] = [
                    (self.declared(str(declared.variable.name)), kind_of(element.init))
                    for element in item.declaration.declarations
                    for declared in element.variables
                ]
            elif isinstance(item, ast.Function):
                self.functions[str(item.name)] = item
            else:
                self.blocks[str(item.name)] = item
        self.shared_kinds: dict[str, Kind] = dict(shared or {})
        self.shared = {name: self.initial(kind) for name, kind in self.shared_kinds.items()}

    def instance(self, name: str) -> Instance:
        """A function block with its initial values."""
        return Instance(self, self.blocks[name])

    def initial(self, kind: Kind) -> Any:
        """Value of a variable before any assignment."""
        if isinstance(kind, tuple):
            return [self.initial(kind[1]) for _ in range(kind[0])]
        if kind == "BOOL":
            return False
        if kind == "STRING":
            return ""
        if kind in self.library:
            return self.library[kind]()
        if kind in self.blocks:
            return self.instance(kind)
        if kind in self.types:
            return {name: self.initial(one) for name, one in self.types[kind]}
        if kind == "REAL":
            return 0.0
        assert kind in RANGES, f"unknown type {kind}"
        return 0


class Instance:
    """Variables of one function block, or of one call of a function."""

    def __init__(self, program: Program, code: Any) -> None:
        self.program = program
        self.code = code
        self.values: dict[str, Any] = {}
        self.kinds: dict[str, Kind] = {}
        for section in code.declarations:
            for item in section.items:
                for declared in item.variables:
                    self._declare(str(declared.variable.name), item.init)
        if isinstance(code, ast.Function):
            self.kinds[str(code.name)] = str(code.return_type.type.type)
            self.values[str(code.name)] = program.initial(self.kinds[str(code.name)])

    def _declare(self, name: str, init: Any) -> None:
        assert name not in self.kinds, f"{name} is declared twice"
        self.kinds[self.program.declared(name)] = kind_of(init)
        self.values[name] = self.program.initial(self.kinds[name])
        if init.value is not None:
            value, kind = self.evaluate(init.value)
            self.values[name] = checked(value, kind, self.kinds[name], name)

    def scan(self) -> None:
        """Run the body once."""
        self._run(self.code.body)

    def _run(self, body: Any) -> None:
        for statement in body.statements if body is not None else ():
            self._execute(statement)

    def _execute(self, statement: Any) -> None:
        match statement:
            case ast.AssignmentStatement():
                (target,) = statement.variables
                self._assign(target, *self.evaluate(statement.expression))
            case ast.IfStatement():
                self._execute_if(statement)
            case ast.CaseStatement():
                self._execute_case(statement)
            case ast.ForStatement():
                first, last = self.evaluate(statement.from_)[0], self.evaluate(statement.to)[0]
                for value in range(first, last + 1):
                    self._assign(statement.control, value, "INT")
                    self._run(statement.statements)
            case ast.FunctionCallStatement():
                self._call_block(statement)
            case _:
                raise NotImplementedError(type(statement).__name__)

    def _execute_if(self, statement: ast.IfStatement) -> None:
        branches = [(statement.if_expression, statement.statements)]
        branches += [(other.if_expression, other.statements) for other in statement.else_ifs]
        for condition, body in branches:
            value, kind = self.evaluate(condition)
            assert kind == "BOOL", f"IF {condition}: {kind}"
            if value:
                self._run(body)
                return
        if statement.else_clause is not None:
            self._run(statement.else_clause.statements)

    def _execute_case(self, statement: ast.CaseStatement) -> None:
        value, _ = self.evaluate(statement.expression)
        for case in statement.cases:
            if value in [self.evaluate(match)[0] for match in case.matches]:
                self._run(case.statements)
                return
        if statement.else_clause is not None:
            self._run(statement.else_clause.statements)

    def _call_block(self, statement: ast.FunctionCallStatement) -> None:
        block, _ = self.evaluate(statement.name)
        inputs = [p for p in statement.parameters if isinstance(p, ast.InputParameterAssignment)]
        block.call({str(p.name.name): self.evaluate(p.value) for p in inputs})
        for parameter in statement.parameters:
            if isinstance(parameter, ast.OutputParameterAssignment):
                self._assign(parameter.value, *block.fields[str(parameter.name.name)])

    def call(self, given: Mapping[str, tuple[Any, Kind]]) -> None:
        """Set inputs, which keep their values between calls, and run the body."""
        for name, (value, kind) in given.items():
            assert name in self.inputs(), f"{name} is no input"
            self.values[name] = copied(checked(value, kind, self.kinds[name], name))
        self.scan()

    @property
    def fields(self) -> dict[str, tuple[Any, Kind]]:
        """Every variable with its type."""
        return {name: (self.values[name], self.kinds[name]) for name in self.values}

    def _assign(self, target: Any, value: Any, kind: Kind) -> None:
        container, key, wanted = self._place(target)
        container[key] = copied(checked(value, kind, wanted, str(target)))

    def _place(self, target: Any) -> tuple[Any, Any, Kind]:
        """Container of a variable, its key there, and its type."""
        is_simple = isinstance(target, ast.SimpleVariable)
        name = str(target.name) if is_simple else str(target.name.name)
        container, kinds = self.values, self.kinds
        if name not in container:
            container, kinds = self.program.shared, self.program.shared_kinds
        key: Any = name
        kind = kinds[name]
        for element in () if is_simple else target.elements:
            inside = container[key]
            if isinstance(element, ast.FieldSelector):
                key = str(element.field.name)
                if isinstance(inside, dict):
                    container, kind = inside, dict(self.program.types[str(kind)])[key]
                else:  # a block, whose variables may be read
                    container = {one: value for one, (value, _) in inside.fields.items()}
                    kind = inside.fields[key][1]
            else:
                assert isinstance(kind, tuple), f"{target}: no array"
                container, key, kind = inside, self._index(element), kind[1]
                assert key < len(inside), f"{target}: beyond the end"
        return container, key, kind

    def _index(self, element: Any) -> int:
        (subscript,) = element.subscripts
        index, _ = self.evaluate(subscript)
        assert index >= 0
        return int(index)

    def evaluate(self, expression: Any) -> tuple[Any, Any]:
        """Value and type of an expression; the type of a literal is "ANY_INT" or "ANY_HEX"."""
        match expression:
            case ast.Duration():
                seconds = float(expression.seconds or 0) + float(expression.milliseconds or 0) / 1000
                return round(seconds * 1000), "TIME"
            case ast.String():
                return str(expression.value)[1:-1], "STRING"
            case ast.Boolean():
                return str(expression.value).upper() == "TRUE", "BOOL"
            case ast.HexInteger():
                return int(str(expression.value), 16), "ANY_HEX"
            case ast.Real():
                return float(str(expression.value)), "REAL"
            case ast.Integer():
                return int(str(expression.value)), "ANY_INT"
            case ast.SimpleVariable() | ast.MultiElementVariable():
                container, key, kind = self._place(expression)
                return container[key], kind
            case ast.ParenthesizedExpression():
                return self.evaluate(expression.expr)
            case ast.UnaryOperation():
                value, kind = self.evaluate(expression.expr)
                assert (str(expression.op).upper(), kind) == ("NOT", "BOOL")
                return not value, "BOOL"
            case ast.BinaryOperation():
                left, right = self.evaluate(expression.left), self.evaluate(expression.right)
                return operate(str(expression.op).upper(), left, right)
            case ast.FunctionCall():
                return self._call(str(expression.name.name), expression.parameters)
        raise NotImplementedError(type(expression).__name__)

    def _call(self, name: str, parameters: Any) -> tuple[Any, str]:
        if name in ("ADR", "SIZEOF"):
            ((value, kind),) = [self.evaluate(parameter.value) for parameter in parameters]
            assert isinstance(kind, tuple) and kind[1] == "WORD"
            return (value, "POINTER") if name == "ADR" else (2 * len(value), "UDINT")
        given = [self.evaluate(parameter.value) for parameter in parameters]
        formal = [str(parameter.name.name) for parameter in parameters if parameter.name is not None]
        if name in ("SHL", "SHR"):
            assert formal in ([], ["IN", "N"])
            (value, kind), (count, _) = given
            return (value << count) & 0xFFFFFFFF if name == "SHL" else value >> count, kind
        conversion = re.fullmatch(r"([A-Z]+)_TO_([A-Z]+)", name)
        if conversion is not None:
            ((value, kind),) = given
            assert kind == conversion[1], f"{name} of {kind}"
            return converted(value, conversion[2]), conversion[2]
        function = Instance(self.program, self.program.functions[name])
        assert formal == function.inputs(), f"{name}({formal})"
        for parameter, (value, kind) in zip(formal, given, strict=True):
            function.values[parameter] = checked(value, kind, function.kinds[parameter], parameter)
        function.scan()
        return function.values[name], function.kinds[name]

    def inputs(self) -> list[str]:
        """Names of the inputs in their order."""
        return [
            str(declared.variable.name)
            for section in self.code.declarations
            if isinstance(section, ast.InputDeclarations)
            for item in section.items
            for declared in item.variables
        ]


class Driven:
    """A block with xExecute and xBusy, called scan by scan in real time, as a PLC's task does.

    scans_to_acknowledge : number of scans after which the cell knows that the result was used.
    """

    block: Instance
    values: dict[str, Any]
    scans_to_acknowledge = 40

    def scan(self) -> None:
        """Run one cycle of the PLC."""
        self.block.scan()

    def until(self, name: str, value: Any = True) -> None:
        """Scan until a variable has a value."""
        deadline_s = time.monotonic() + LIMIT_S
        self.scan()
        while self.values[name] != value:
            assert time.monotonic() < deadline_s, f"not in time: {name} = {value}"
            self.scan()

    def run(self, **inputs: Any) -> None:
        """Raise xExecute and scan until the block is no longer busy."""
        self.values |= inputs | {"xExecute": True}
        self.scan()
        assert self.values["xBusy"]
        self.until("xBusy", False)

    def release(self) -> None:
        """Lower xExecute and scan until the cell knows."""
        self.values["xExecute"] = False
        for _ in range(self.scans_to_acknowledge):
            self.scan()


def kind_of(init: Any) -> Kind:
    """Type of a declaration."""
    if isinstance(init, ast.ArrayTypeInitialization):
        (subrange,) = init.spec.subranges
        return int(str(subrange.stop.value)) + 1, str(init.spec.type.type_name)  # from 0, whatever the start
    kind = str(init.spec.type)
    return "STRING" if kind.startswith("STRING(") else kind


def copied(value: Any) -> Any:
    """Copy of a structure or array, which are values."""
    return copy.deepcopy(value) if isinstance(value, list | dict) else value


def checked(value: Any, kind: Kind, wanted: Kind, place: str) -> Any:
    """The value. Fails unless a variable of the wanted type can hold it."""
    assert kind == wanted or wanted in LITERALS.get(str(kind), ()), f"{place}: {wanted} := {kind}"
    if isinstance(wanted, str) and wanted in RANGES:
        low, high = RANGES[wanted]
        assert low <= value <= high, f"{place}: {value} does not fit {wanted}"
    return value


def converted(value: int, wanted: str) -> float:
    """Convert as X_TO_Y does on PLCs, keeping the bits that fit; a REAL has 24 of them."""
    if wanted == "REAL":
        return float(np.float32(value))
    low, high = RANGES[wanted]
    value &= (1 << (high - low).bit_length()) - 1
    return value if value <= high else value - (high - low + 1)


def operate(op: str, left: tuple[Any, str], right: tuple[Any, str]) -> tuple[Any, str]:
    """Apply a binary operator; both sides must have the same type (or one is a literal)."""
    (a, kind), (b, other) = left, right
    fits = kind == other or other in LITERALS.get(kind, ()) or kind in LITERALS.get(other, ())
    assert fits or {kind, other} <= LITERALS.keys(), f"{kind} {op} {other}"
    kind = other if kind in LITERALS else kind
    if op in ("AND", "OR"):
        return (a & b) if op == "AND" else (a | b), kind
    compared = {"=": a == b, "<>": a != b, ">": a > b, "<": a < b, ">=": a >= b, "<=": a <= b}
    if op in compared:
        return compared[op], "BOOL"
    if op == "/":
        assert kind == "REAL", f"{kind} {op}: what is left over is lost"
        return float(np.float32(a) / np.float32(b)), kind
    value = {"+": a + b, "-": a - b, "*": a * b}[op]
    return checked(value, kind, kind, f"{kind} {op}"), kind
