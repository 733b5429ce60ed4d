"""Common parts of the interpreters of robot languages: statements, routines, and how they run.

RAPID, KRL, KAREL, VAL 3, AS and SPEL+ have the same statements in other words. Each of `rapid`, `krl`,
`karel`, `val3`, `kawasaki` and `spel` turns the lines of a generated program into the statements below and
adds its types and built-in routines. As strict as a compiler: unknown names and statements are errors, as
are those of `robotvalues` and `robotexpressions`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from helpers.robotexpressions import Code, Compiler
from helpers.robotvalues import Array, Types, Value, Variable
from helpers.robotwords import Declared


class Assign(NamedTuple):
    """Assignment: target := value."""

    target: str
    value: str


class Call(NamedTuple):
    """Call of a routine by name; the arguments are one text."""

    name: str
    arguments: str


class If(NamedTuple):
    """branches : conditions and the statements they guard; the condition of an ELSE is ""."""

    branches: list[tuple[str, list[Any]]]


class While(NamedTuple):
    """Loop that runs while the condition holds."""

    condition: str
    body: list[Any]


class For(NamedTuple):
    """Loop whose counter runs from first to last."""

    name: str
    first: str
    last: str
    body: list[Any]


class Return(NamedTuple):
    """Return from a routine; "" without a value."""

    value: str


class Returned(Exception):
    """A routine returned."""

    def __init__(self, value: Any) -> None:
        self.value = value
        super().__init__()


@dataclass
class Parameter:
    """name, type, and whether it is the caller's variable; size of an array: 0 is none, -1 is any."""

    name: str
    type: str
    by_reference: bool
    is_array: bool = False


@dataclass
class Routine:
    """A declared routine."""

    name: str
    parameters: list[Parameter]
    returns: str
    locals: list[tuple[str, str, int, str]] = field(default_factory=list)  # name, type, size or 0, initial
    body: list[Any] = field(default_factory=list)
    handler: list[Any] | None = None


class Leave(NamedTuple):
    """Early exit from a routine: Exit Function, Exit Sub."""


class OnError(NamedTuple):
    """Label to which errors of this routine go from now on; "" for none."""

    label: str


@dataclass
class Function(Routine):
    """A routine with error labels: its lines from each label on."""

    labels: dict[str, list[Any]] | None = None


class Syntax:
    """How a language writes statements, one per line: patterns that begin blocks, "" where it has none.

    Blocks end with ELSE, ENDIF, ENDWHILE and ENDFOR, in either case.
    """

    IF = r"IF (.+) THEN$"
    ELSE_IF = ""
    WHILE = r"WHILE (.+) DO$"
    FOR = ""

    def opens_if(self, line: str) -> str | None:
        """Condition of an IF, or None."""
        return _first(self.IF, line)

    def opens_else_if(self, line: str) -> str | None:
        """Condition of an ELSE IF, or None."""
        return _first(self.ELSE_IF, line)

    def opens_while(self, line: str) -> str | None:
        """Condition of a WHILE, or None."""
        return _first(self.WHILE, line)

    def opens_for(self, line: str) -> tuple[str, str, str] | None:
        """Counter, first and last value of a FOR, or None."""
        found = re.match(self.FOR, line) if self.FOR else None
        return (found[1], found[2], found[3]) if found else None

    def simple(self, line: str) -> Any:
        """Parse any other statement."""
        raise NotImplementedError


def _first(pattern: str, line: str) -> str | None:
    found = re.match(pattern, line) if pattern else None
    return found[1] if found else None


def block(lines: Sequence[str], start: int, syntax: Syntax, ends: set[str]) -> tuple[list[Any], int]:
    """Statements up to a line in `ends`, and the index of that line."""
    body: list[Any] = []
    at = start
    while lines[at].upper() not in ends and syntax.opens_else_if(lines[at]) is None:
        line = lines[at]
        if (condition := syntax.opens_if(line)) is not None:
            branches = []
            while True:
                inner, at = block(lines, at + 1, syntax, {"ELSE", "ENDIF"})
                branches.append((condition, inner))
                if lines[at].upper() == "ENDIF":
                    break
                condition = syntax.opens_else_if(lines[at]) or ""
            body.append(If(branches))
        elif (condition := syntax.opens_while(line)) is not None:
            inner, at = block(lines, at + 1, syntax, {"ENDWHILE"})
            body.append(While(condition, inner))
        elif (counted := syntax.opens_for(line)) is not None:
            inner, at = block(lines, at + 1, syntax, {"ENDFOR"})
            body.append(For(*counted, inner))
        else:
            body.append(syntax.simple(line))
        at += 1
    return body, at


class Program:
    """A program that can be called.

    language : whose reserved words no name may be. equals : its equality operator; index : its brackets.
    """

    def __init__(self, language: str, types: Types, equals: str, index: str) -> None:
        self.declared = Declared(language)
        self.types = types
        self.equals = equals
        self.index = index
        self.routines: dict[str, Routine] = {}
        self.globals: dict[str, Variable | Array] = {}
        self.builtins: dict[str, Callable[..., Any]] = {}
        self.on_error: type[Exception] | None = None
        self.error: Exception | None = None
        self._frames: list[dict[str, Any]] = []
        self._expressions: dict[str, Code] = {}
        self._lists: dict[str, list[Code]] = {}

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a routine with values, or with variables for its output parameters."""
        return self.run(self.routines[name.upper()], [self._place(one) for one in arguments])

    def _place(self, value: Any) -> Any:
        if isinstance(value, (Variable, Array, Value)):
            return value
        return Value("", value)

    def run(self, routine: Routine, arguments: list[Any]) -> Any:
        """Execute one call; returns its value, fitted to its type."""
        assert len(routine.parameters) == len(arguments), f"{routine.name}: {len(arguments)} arguments"
        frame: dict[str, Any] = {}
        for parameter, given in zip(routine.parameters, arguments, strict=True):
            if parameter.is_array:
                assert isinstance(given, Array) and given.type == parameter.type, parameter.name
                frame[parameter.name] = given
            elif parameter.by_reference:
                assert isinstance(given, Variable) and given.type == parameter.type, parameter.name
                frame[parameter.name] = given
            else:
                frame[parameter.name] = self.types.variable(parameter.type, given.get())
        self._frames.append(frame)
        try:
            for name, kind, size, initial in routine.locals:
                assert name not in frame, f"{name} is declared twice"
                frame[name] = self.types.array(kind, size) if size else self.types.variable(kind)
                if initial:
                    frame[name].set(self.evaluate(initial).get())
            try:
                self._guarded(routine)
            except Returned as returned:
                assert (returned.value is None) == (not routine.returns), routine.name
                return self.types.fitted(routine.returns, returned.value) if routine.returns else None
            assert not routine.returns, f"{routine.name} ends without a value"
            return None
        finally:
            self._frames.pop()

    def _guarded(self, routine: Routine) -> None:
        if routine.handler is None or self.on_error is None:
            self.execute(routine.body)
            return
        try:
            self.execute(routine.body)
        except self.on_error as error:
            self.error = error
            self.execute(routine.handler)
            raise

    def execute(self, body: list[Any]) -> None:
        """Execute statements in order."""
        for one in body:
            self.statement(one)

    def statement(self, one: Any) -> None:
        """Execute one statement."""
        if isinstance(one, Assign):
            self.place(one.target).set(self.evaluate(one.value).get())
        elif isinstance(one, If):
            for condition, inner in one.branches:
                if not condition or self._holds(condition):
                    self.execute(inner)
                    break
        elif isinstance(one, Call):
            self.invoke(one.name, self._arguments(one.arguments), is_statement=True)
        elif isinstance(one, While):
            while self._holds(one.condition):
                self.execute(one.body)
        elif isinstance(one, For):
            self._count(one)
        elif isinstance(one, Return):
            raise Returned(self.evaluate(one.value).get() if one.value else None)
        else:
            raise TypeError(f"no statement: {one!r}")

    def _count(self, one: For) -> None:
        first, last = self.evaluate(one.first).get(), self.evaluate(one.last).get()
        frame = self._frames[-1]
        kept = frame.get(one.name.upper())
        counter = kept if kept is not None else Variable("", 0, _Counter({}))
        frame[one.name.upper()] = counter
        for number in range(int(first), int(last) + 1):
            counter.set(number)
            self.execute(one.body)
        if kept is None:
            del frame[one.name.upper()]

    def _holds(self, condition: str) -> bool:
        value = self.evaluate(condition).get()
        assert isinstance(value, bool), f"{condition} is no condition"
        return value

    def invoke(self, name: str, arguments: list[Any], *, is_statement: bool = False) -> Any:
        """Call a routine of the program, or a built-in one."""
        routine = self.routines.get(name.upper())
        if routine is not None:
            assert is_statement != bool(routine.returns), f"{name}: a function is no instruction"
            return self.run(routine, arguments)
        if name.upper() not in self.builtins:
            raise NameError(f"no routine {name}")
        return self.builtins[name.upper()](*arguments)

    def _arguments(self, text: str) -> list[Any]:
        if text not in self._lists:
            self._lists[text] = Compiler(text, self).arguments()
        return [one() for one in self._lists[text]]

    def evaluate(self, text: str) -> Any:
        """Value of an expression, or the variable that the text names."""
        if text not in self._expressions:
            self._expressions[text] = Compiler(text, self).expression()
        return self._expressions[text]()

    def place(self, text: str) -> Any:
        """Variable that the text names."""
        value = self.evaluate(text)
        assert isinstance(value, (Variable, Array)), f"{text} is no variable"
        return value

    def named(self, name: str) -> Any:
        """Variable by its name."""
        name = name.upper()
        found = self._frames[-1].get(name) if self._frames else None
        found = self.globals.get(name) if found is None else found
        if found is None:
            raise NameError(f"no variable {name}")
        return found


class LabelledProgram(Program):
    """A program whose routines may be left early, and each have a label for their errors."""

    def __init__(self, language: str, types: Types, equals: str, index: str) -> None:
        super().__init__(language, types, equals, index)
        self.places: list[str] = []

    def run(self, routine: Routine, arguments: list[Any]) -> Any:
        """Execute one call, with no error label until the routine sets one."""
        self.places.append("")
        try:
            return super().run(routine, arguments)
        finally:
            self.places.pop()

    def statement(self, one: Any) -> None:
        """Execute one statement."""
        if isinstance(one, Leave):
            raise Returned(None)
        if isinstance(one, OnError):
            self.places[-1] = one.label
        else:
            super().statement(one)


class _Counter(Types):
    """Type of a loop counter: any integer."""

    def fitted(self, kind: str, value: Any) -> Any:
        return value
