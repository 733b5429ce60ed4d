"""What the interpreters of robot languages share: expressions, statements, variables with types.

RAPID, KRL, KAREL, VAL 3, AS and SPEL+ have the same statements in other words. Each of `rapid`, `krl`,
`karel`, `val3`, `kawasaki` and `spel` turns the lines of a generated program into the statements below and
brings its types and built-in routines. As strict as a compiler: unknown names, another type, a text that is
too long, an index outside of an array are errors.
Where the languages rank operators differently, the subset wants parentheses.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

TOKEN = re.compile(
    r"\s*(?:(?P<number>\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)|(?P<text>\"[^\"]*\"|'[^']*')|(?P<name>[$A-Za-z_][\w$]*)"
    r"|(?P<mark>:=|::|<>|!=|<=|>=|==|[-+*/=<>(),\[\]{}.#\\]))"
)
COMPARED: dict[str, Callable[[Any, Any], bool]] = {
    "<": lambda a, b: a < b,
    ">": lambda a, b: a > b,
    "<=": lambda a, b: a <= b,
    ">=": lambda a, b: a >= b,
    "<>": lambda a, b: a != b,
    "!=": lambda a, b: a != b,
}


def single(value: float) -> float:
    """Rounded to the 32 bits of a robot's number."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


class Place(Protocol):
    """Something that can be read, and perhaps written."""

    type: str

    def get(self) -> Any: ...
    def set(self, value: Any) -> None: ...


@dataclass
class Value:
    """The value of an expression."""

    type: str
    value: Any

    def get(self) -> Any:
        """What it is."""
        return self.value

    def set(self, value: Any) -> None:
        """There is nothing to write to."""
        raise TypeError("an expression is no variable")


@dataclass
class Variable:
    """A variable, an element of one, or a field of a record: `types` checks what is written."""

    type: str
    value: Any
    types: Types
    is_constant: bool = False

    def get(self) -> Any:
        """What it holds."""
        return self.value

    def set(self, value: Any) -> None:
        """Raises TypeError for what does not fit."""
        if self.is_constant:
            raise TypeError("a constant is written to")
        self.value = self.types.fitted(self.type, value)


@dataclass
class Array:
    """Elements from 1 on, or from another first."""

    type: str
    elements: list[Variable]
    first: int = 1

    def get(self) -> Any:
        """The whole of it."""
        return self

    def set(self, value: Any) -> None:
        """No language of these is used so."""
        raise TypeError("an array is written as a whole")

    def element(self, index: Any) -> Variable:
        """Raises IndexError outside of its size."""
        if not float(index).is_integer() or not 0 <= index - self.first < len(self.elements):
            raise IndexError(f"{index} of {len(self.elements)}")
        return self.elements[int(index) - self.first]


@dataclass
class Record:
    """A value with named fields."""

    type: str
    fields: dict[str, Variable]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Record) and self.plain() == other.plain()

    def plain(self) -> dict[str, Any]:
        """Names and values, down to numbers."""
        return {
            name: one.value.plain() if isinstance(one.value, Record) else one.value
            for name, one in self.fields.items()
        }


class Types:
    """The types of a language. records : type, its fields and their types."""

    def __init__(
        self,
        scalars: dict[str, tuple[Any, Callable[[Any], Any]]],
        records: dict[str, dict[str, str]] | None = None,
    ) -> None:
        self.scalars = scalars
        self.records = records or {}

    def fitted(self, kind: str, value: Any) -> Any:
        """The value as a variable of that type holds it; raises TypeError."""
        if kind in self.records:
            if not isinstance(value, Record) or value.type != kind:
                raise TypeError(f"{value!r} is no {kind}")
            return self.copied(value)
        return self.scalars[kind][1](value)

    def copied(self, record: Record) -> Record:
        """A record of its own."""
        kinds = self.records[record.type]
        return Record(
            record.type, {name: self.variable(kinds[name], one.value) for name, one in record.fields.items()}
        )

    def variable(self, kind: str, value: Any = None) -> Variable:
        """A new variable with the type's initial value."""
        if value is None:
            value = self.initial(kind)
        return Variable(kind, self.fitted(kind, value), self)

    def initial(self, kind: str) -> Any:
        """What a variable holds that was given nothing."""
        if kind in self.records:
            return Record(kind, {name: self.variable(one) for name, one in self.records[kind].items()})
        if kind not in self.scalars:
            raise TypeError(f"no type {kind}")
        return self.scalars[kind][0]

    def array(self, kind: str, size: int) -> Array:
        """With the type's initial values."""
        return Array(kind, [self.variable(kind) for _ in range(size)])


# --- statements ------------------------------------------------------------------------------------


class Assign(NamedTuple):
    """target := value."""

    target: str
    value: str


class Call(NamedTuple):
    """A routine by its name; the arguments are one text."""

    name: str
    arguments: str


class If(NamedTuple):
    """branches : conditions and what they guard; the condition of an ELSE is ""."""

    branches: list[tuple[str, list[Any]]]


class While(NamedTuple):
    """While the condition holds."""

    condition: str
    body: list[Any]


class For(NamedTuple):
    """The name counts from first to last."""

    name: str
    first: str
    last: str
    body: list[Any]


class Return(NamedTuple):
    """Of a routine; "" without a value."""

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
    """What was declared."""

    name: str
    parameters: list[Parameter]
    returns: str
    locals: list[tuple[str, str, int, str]] = field(default_factory=list)  # name, type, size or 0, initial
    body: list[Any] = field(default_factory=list)
    handler: list[Any] | None = None


class Syntax(Protocol):
    """How a language writes statements; each gives None for a line that is something else."""

    def opens_if(self, line: str) -> str | None: ...
    def opens_else_if(self, line: str) -> str | None: ...
    def opens_while(self, line: str) -> str | None: ...
    def opens_for(self, line: str) -> tuple[str, str, str] | None: ...
    def simple(self, line: str) -> Any: ...


def block(lines: Sequence[str], start: int, syntax: Syntax, ends: set[str]) -> tuple[list[Any], int]:
    """Statements up to a line of `ends`, and where that line is."""
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


# --- running -----------------------------------------------------------------------------------------


class Program:
    """A program that can be called. equals : how the language writes equality; index : its brackets."""

    def __init__(self, types: Types, equals: str, index: str) -> None:
        self.types = types
        self.equals = equals
        self.index = index
        self.routines: dict[str, Routine] = {}
        self.globals: dict[str, Variable | Array] = {}
        self.builtins: dict[str, Callable[..., Any]] = {}
        self.on_error: type[Exception] | None = None
        self.error: Exception | None = None
        self._frames: list[dict[str, Any]] = []

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a routine with values, or with variables for what it writes."""
        return self.run(self.routines[name.upper()], [self._place(one) for one in arguments])

    def _place(self, value: Any) -> Any:
        if isinstance(value, (Variable, Array, Value)):
            return value
        return Value("", value)

    def run(self, routine: Routine, arguments: list[Any]) -> Any:
        """One call; what it returns, fitted to its type."""
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
        """Statements, one after the other."""
        for one in body:
            if isinstance(one, Assign):
                self.place(one.target).set(self.evaluate(one.value).get())
            elif isinstance(one, Call):
                self.invoke(one.name, self._arguments(one.arguments), is_statement=True)
            elif isinstance(one, If):
                for condition, inner in one.branches:
                    if not condition or self._holds(condition):
                        self.execute(inner)
                        break
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
        """A routine of the program, or one that is built in."""
        routine = self.routines.get(name.upper())
        if routine is not None:
            assert is_statement != bool(routine.returns), f"{name}: a function is no instruction"
            return self.run(routine, arguments)
        if name.upper() not in self.builtins:
            raise NameError(f"no routine {name}")
        return self.builtins[name.upper()](*arguments)

    def _arguments(self, text: str) -> list[Any]:
        parser = _Parser(text, self)
        arguments = [] if parser.at_end() else parser.list_of_values()
        assert parser.at_end(), text
        return arguments

    def evaluate(self, text: str) -> Any:
        """A value, or the variable that the text names."""
        parser = _Parser(text, self)
        value = parser.condition()
        assert parser.at_end(), f"what follows {text}"
        return value

    def place(self, text: str) -> Any:
        """A variable."""
        value = self.evaluate(text)
        assert isinstance(value, (Variable, Array)), f"{text} is no variable"
        return value

    def named(self, name: str) -> Any:
        """A variable by its name."""
        for scope in (self._frames[-1] if self._frames else {}, self.globals):
            if name.upper() in scope:
                return scope[name.upper()]
        raise NameError(f"no variable {name}")


class _Counter(Types):
    """Of a loop: any whole number."""

    def fitted(self, kind: str, value: Any) -> Any:
        return value


class _Parser:
    """Evaluates while it reads: the programs are small, and nothing is kept."""

    def __init__(self, text: str, program: Program) -> None:
        self.tokens: list[tuple[str, str]] = []
        at = 0
        while at < len(text.rstrip()):
            found = TOKEN.match(text, at)
            assert found is not None and found.lastgroup is not None, f"not understood: {text[at:]}"
            self.tokens.append((found.lastgroup, found[found.lastgroup]))
            at = found.end()
        self.at = 0
        self.program = program
        self.text = text

    def at_end(self) -> bool:
        """Nothing follows."""
        return self.at == len(self.tokens)

    def peek(self) -> str:
        """The next token, upper case, or "" for a text literal."""
        if self.at_end() or self.tokens[self.at][0] == "text":
            return ""
        return self.tokens[self.at][1].upper()

    def take(self, *expected: str) -> str:
        """The next token, one of the expected."""
        assert self.peek() in expected, f"expected {expected} in {self.text}"
        self.at += 1
        return self.tokens[self.at - 1][1].upper()

    def list_of_values(self) -> list[Any]:
        r"""Arguments; \name:=value are `(name, value)`, and \name is `(name, None)`."""
        values: list[Any] = []
        while True:
            while self.peek() == "\\":
                self.take("\\")
                name = self.tokens[self.at][1]
                self.at += 1
                if self.peek() == ":=":
                    self.take(":=")
                    values.append((name.lower(), self.condition()))
                else:
                    values.append((name.lower(), None))
            if self.at_end() or self.peek() in (")", "]"):
                return values
            if values:
                self.take(",")
            values.append(self.condition())

    def condition(self) -> Any:
        """Comparisons by one of AND and OR: the languages rank them differently."""
        left = self.negation()
        word = self.peek()
        while self.peek() in ("AND", "OR"):
            assert self.take("AND", "OR") == word, f"AND beside OR: {self.text}"
            right = self.negation()
            assert isinstance(left.get(), bool) and isinstance(right.get(), bool), self.text
            both = left.get() and right.get() if word == "AND" else left.get() or right.get()
            left = Value("bool", both)
        return left

    def negation(self) -> Any:
        """NOT of a name or of parentheses."""
        if self.peek() != "NOT":
            return self.comparison()
        self.take("NOT")
        value = self.primary().get()
        assert isinstance(value, bool), self.text
        return Value("bool", not value)

    def comparison(self) -> Any:
        """At most one."""
        left = self.sum()
        mark = self.peek()
        if mark not in (*COMPARED, self.program.equals):
            return left
        self.at += 1
        right = self.sum()
        one, other = left.get(), right.get()
        numbers = all(isinstance(each, (int, float)) and not isinstance(each, bool) for each in (one, other))
        assert numbers or type(one) is type(other), f"{one!r} against {other!r}: {self.text}"
        compare = COMPARED.get(mark, lambda a, b: a == b)
        return Value("bool", compare(one, other))

    def sum(self) -> Any:
        """Terms."""
        left = self.term()
        while self.peek() in ("+", "-"):
            mark = self.take("+", "-")
            left = self.computed(left, mark, self.term())
        return left

    def term(self) -> Any:
        """Factors."""
        left = self.factor()
        while self.peek() in ("*", "/", "DIV", "MOD"):
            mark = self.take("*", "/", "DIV", "MOD")
            left = self.computed(left, mark, self.factor())
        return left

    def computed(self, left: Any, mark: str, right: Any) -> Any:
        """Texts are joined, whole numbers stay whole, others are rounded to 32 bits."""
        a, b = left.get(), right.get()
        if isinstance(a, str) and isinstance(b, str) and mark == "+":
            return Value("text", self.program.types.fitted("text", a + b))
        assert not isinstance(a, (bool, str)) and not isinstance(b, (bool, str)), self.text
        if mark in ("DIV", "MOD"):
            assert float(a).is_integer() and float(b).is_integer() and a >= 0 and b > 0, self.text
            return Value("", a // b if mark == "DIV" else a % b)
        if isinstance(a, int) and isinstance(b, int):
            result = {"+": a + b, "-": a - b, "*": a * b}.get(mark)
            if result is None:  # KRL: of whole numbers a whole one; KAREL has DIV for that
                assert self.program.equals == "==", f"/ of whole numbers: {self.text}"
                result = int(a / b)
            assert abs(result) < 2**31, f"overflow: {self.text}"
            return Value("", result)
        return Value("", single({"+": a + b, "-": a - b, "*": a * b, "/": a / b if b else 0.0}[mark]))

    def factor(self) -> Any:
        """A sign and a primary."""
        if self.peek() == "-":
            self.take("-")
            value = self.primary().get()
            assert isinstance(value, (int, float)) and not isinstance(value, bool)
            return Value("", -value)
        return self.primary()

    def primary(self) -> Any:
        """A literal, a variable with indices and fields, a call, or parentheses."""
        kind, text = self.tokens[self.at]
        self.at += 1
        if kind == "number":
            whole = text.isdigit()
            return Value("", int(text) if whole else single(float(text)))
        if kind == "text":
            return Value("text", self.program.types.fitted("literal", text))
        if text == "(":
            value = self.condition()
            self.take(")")
            return Value(value.type, value.get())
        if text == "#":
            self.at += 1
            return Value("enum", "#" + self.tokens[self.at - 1][1].upper())
        assert kind == "name", f"{text} in {self.text}"
        if text.upper() in ("TRUE", "FALSE"):
            return Value("bool", text.upper() == "TRUE")
        if self.peek() == "(":
            self.take("(")
            arguments = [] if self.peek() == ")" else self.list_of_values()
            self.take(")")
            return Value("", self.program.invoke(text, arguments))
        return self._parts(self.program.named(text))

    def _parts(self, place: Any) -> Any:
        opening, closing = self.program.index
        while self.peek() in (opening, "."):
            if self.take(opening, ".") == ".":
                name = self.tokens[self.at][1].lower()
                self.at += 1
                place = place.get().fields[name]
            elif self.peek() == closing:  # KRL: the whole array
                self.take(closing)
            else:
                place = place.element(self.condition().get())
                self.take(closing)
        return place
