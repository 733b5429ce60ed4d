"""A tree-walking interpreter for the structured text that edged writes, on the syntax tree of blark.

As strict as a compiler: unknown names, values that do not fit their type and mixed types are errors, so
that what runs here is not only well formed. It knows what `FB_EDGED` uses, not the whole of IEC 61131-3.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from typing import Any

from blark import transform as ast
from blark.parse import parse_source_code

LITERALS = {
    "ANY_INT": {"INT", "DINT", "UINT", "UDINT"},
    "ANY_HEX": {"INT", "DINT", "UINT", "UDINT", "WORD", "DWORD"},
}
"""Types that a literal may have: a decimal number is no bit string (IEC 61131-3, 6.3.2 and table 10)."""
RANGES = {
    "INT": (-(2**15), 2**15 - 1),
    "DINT": (-(2**31), 2**31 - 1),
    "UINT": (0, 2**16 - 1),
    "UDINT": (0, 2**32 - 1),
    "WORD": (0, 2**16 - 1),
    "DWORD": (0, 2**32 - 1),
    "TIME": (0, 2**32 - 1),  # ms
}


@functools.cache
def parse(source: str) -> list[Any]:
    """Declarations of a source; raises what blark says about a mistake. Seconds, so it is kept."""
    parsed = parse_source_code(source)
    if parsed.exception is not None:
        raise parsed.exception
    return list(parsed.transform().items)


class Timer:
    """TON: Q rises when IN has been true for PT ms of the program's clock."""

    def __init__(self, clock_ms: Callable[[], float]) -> None:
        self._clock_ms = clock_ms
        self._since_ms: float | None = None
        self.fields: dict[str, Any] = {"Q": False}

    def call(self, given: dict[str, Any]) -> None:
        if not given["IN"]:
            self._since_ms = None
        elif self._since_ms is None:
            self._since_ms = self._clock_ms()
        self.fields["Q"] = self._since_ms is not None and self._clock_ms() - self._since_ms >= given["PT"]


class Program:
    """Parsed source: makes instances of its function blocks."""

    def __init__(self, source: str, clock_ms: Callable[[], float]) -> None:
        self.clock_ms = clock_ms
        self.types: dict[str, list[tuple[str, str]]] = {}
        self.functions: dict[str, ast.Function] = {}
        self.blocks: dict[str, ast.FunctionBlock] = {}
        for item in parse(source):
            if isinstance(item, ast.DataTypeDeclaration):
                self.types[str(item.declaration.name)] = [
                    (str(declared.variable.name), str(element.init.spec.type))
                    for element in item.declaration.declarations
                    for declared in element.variables
                ]
            elif isinstance(item, ast.Function):
                self.functions[str(item.name)] = item
            else:
                self.blocks[str(item.name)] = item

    def instance(self, name: str) -> Instance:
        """A function block with its initial values."""
        return Instance(self, self.blocks[name])

    def initial(self, kind: str) -> Any:
        """The value a variable has before anything was assigned."""
        if kind == "BOOL":
            return False
        if kind == "TON":
            return Timer(self.clock_ms)
        if kind in self.types:
            return {name: self.initial(one) for name, one in self.types[kind]}
        assert kind in RANGES, f"unknown type {kind}"
        return 0


class Instance:
    """Variables of one function block, or of one call of a function."""

    def __init__(self, program: Program, code: Any) -> None:
        self.program = program
        self.code = code
        self.values: dict[str, Any] = {}
        self.kinds: dict[str, str] = {}
        for section in code.declarations:
            for item in section.items:
                for declared in item.variables:
                    self._declare(str(declared.variable.name), item.init)
        if isinstance(code, ast.Function):
            self.kinds[str(code.name)] = str(code.return_type.type.type)
            self.values[str(code.name)] = program.initial(self.kinds[str(code.name)])

    def _declare(self, name: str, init: Any) -> None:
        assert name not in self.kinds, f"{name} is declared twice"
        if isinstance(init, ast.ArrayTypeInitialization):
            (subrange,) = init.spec.subranges
            kind = str(init.spec.type.type_name)
            assert str(subrange.start.value) == "0"
            self.values[name] = [self.program.initial(kind)] * (int(str(subrange.stop.value)) + 1)
            self.kinds[name] = kind
            return
        self.kinds[name] = str(init.spec.type)
        self.values[name] = self.program.initial(self.kinds[name])
        if init.value is not None:
            self.values[name] = self.evaluate(init.value)[0]

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
                block = self.values[str(statement.name.name)]
                given = {str(p.name.name): self.evaluate(p.value)[0] for p in statement.parameters}
                block.call(given)
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

    def _assign(self, target: Any, value: Any, kind: str) -> None:
        if isinstance(target, ast.SimpleVariable):
            name = str(target.name)
            wanted = self.kinds[name]
            self.values[name] = checked(value, kind, wanted, name)
            return
        name, (element,) = str(target.name.name), target.elements
        if isinstance(element, ast.FieldSelector):
            field = str(element.field.name)
            wanted = dict(self.program.types[self.kinds[name]])[field]
            self.values[name][field] = checked(value, kind, wanted, f"{name}.{field}")
            return
        index = self._index(element)
        self.values[name][index] = checked(value, kind, self.kinds[name], f"{name}[{index}]")

    def _index(self, element: Any) -> int:
        (subscript,) = element.subscripts
        index, _ = self.evaluate(subscript)
        assert index >= 0
        return int(index)

    def evaluate(self, expression: Any) -> tuple[Any, str]:
        """Value and type of an expression; a literal has the type "ANY_INT", or "ANY_HEX"."""
        match expression:
            case ast.Duration():
                seconds = float(expression.seconds or 0) + float(expression.milliseconds or 0) / 1000
                return round(seconds * 1000), "TIME"
            case ast.Boolean():
                return str(expression.value).upper() == "TRUE", "BOOL"
            case ast.HexInteger():
                return int(str(expression.value), 16), "ANY_HEX"
            case ast.Integer():
                return int(str(expression.value)), "ANY_INT"
            case ast.SimpleVariable():
                name = str(expression.name)
                return self.values[name], self.kinds[name]
            case ast.MultiElementVariable():
                return self._element(expression)
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

    def _element(self, expression: ast.MultiElementVariable) -> tuple[Any, str]:
        name, (element,) = str(expression.name.name), expression.elements
        if isinstance(element, ast.FieldSelector):
            field = str(element.field.name)
            value = self.values[name]
            if isinstance(value, Timer):
                return value.fields[field], "BOOL"
            return value[field], dict(self.program.types[self.kinds[name]])[field]
        return self.values[name][self._index(element)], self.kinds[name]

    def _call(self, name: str, parameters: Any) -> tuple[Any, str]:
        given = [self.evaluate(parameter.value) for parameter in parameters]
        formal = [str(parameter.name.name) for parameter in parameters if parameter.name is not None]
        if name in ("SHL", "SHR"):
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
            if isinstance(value, list):
                assert len(value) == len(function.values[parameter])
            else:
                value = checked(value, kind, function.kinds[parameter], parameter)
            function.values[parameter] = value
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


def checked(value: Any, kind: str, wanted: str, place: str) -> Any:
    """The value, if a variable of the wanted type can hold it."""
    assert kind == wanted or wanted in LITERALS.get(kind, ()), f"{place}: {wanted} := {kind}"
    if wanted in RANGES:
        low, high = RANGES[wanted]
        assert low <= value <= high, f"{place}: {value} does not fit {wanted}"
    return value


def converted(value: int, wanted: str) -> int:
    """X_TO_Y keeps the bits that fit, as PLCs do."""
    low, high = RANGES[wanted]
    value &= (1 << (high - low).bit_length()) - 1
    return value if value <= high else value - (high - low + 1)


def operate(op: str, left: tuple[Any, str], right: tuple[Any, str]) -> tuple[Any, str]:
    """One binary operation; both sides must be of one type (or one of them a literal)."""
    (a, kind), (b, other) = left, right
    fits = kind == other or other in LITERALS.get(kind, ()) or kind in LITERALS.get(other, ())
    assert fits or {kind, other} <= LITERALS.keys(), f"{kind} {op} {other}"
    kind = other if kind in LITERALS else kind
    if op in ("AND", "OR"):
        return (a & b) if op == "AND" else (a | b), kind
    compared = {"=": a == b, "<>": a != b, ">": a > b, "<": a < b, ">=": a >= b, "<=": a <= b}
    if op in compared:
        return compared[op], "BOOL"
    value = {"+": a + b, "-": a - b, "*": a * b}[op]
    return checked(value, kind, kind, f"{kind} {op}"), kind
