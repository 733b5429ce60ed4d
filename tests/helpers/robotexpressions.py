"""Expressions of the robots' languages, compiled once and evaluated each time their statement runs.

Where the languages rank operators differently, the subset requires parentheses.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from helpers.robotvalues import Value, single

if TYPE_CHECKING:
    from helpers.robotlanguage import Program

TOKEN = re.compile(
    r"\s*(?:(?P<number>\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)|(?P<text>\"[^\"]*\"|'[^']*')|(?P<name>[$A-Za-z_][\w$]*%?)"
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
Code = Callable[[], Any]
"""Compiled code: returns a value, or a place, on each call."""


class Compiler:
    """Compiles an expression once; the result is evaluated as often as the statement runs."""

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

    def expression(self) -> Code:
        """Compile the whole text as one expression."""
        made = self.condition()
        assert self.at_end(), f"what follows {self.text}"
        return made

    def arguments(self) -> list[Code]:
        """Compile the whole text as an argument list."""
        made = [] if self.at_end() else self.list_of_values()
        assert self.at_end(), self.text
        return made

    def at_end(self) -> bool:
        """Whether all tokens are consumed."""
        return self.at == len(self.tokens)

    def peek(self) -> str:
        """Next token, upper case, or "" for a text literal."""
        if self.at_end() or self.tokens[self.at][0] == "text":
            return ""
        return self.tokens[self.at][1].upper()

    def take(self, *expected: str) -> str:
        """Consume the next token, which must be one of the expected."""
        assert self.peek() in expected, f"expected {expected} in {self.text}"
        self.at += 1
        return self.tokens[self.at - 1][1].upper()

    def list_of_values(self) -> list[Code]:
        r"""Arguments; \name:=value are `(name, value)`, and \name is `(name, None)`."""
        values: list[Code] = []
        while True:
            while self.peek() == "\\":
                self.take("\\")
                name = self.tokens[self.at][1].lower()
                self.at += 1
                given: Code = lambda: None  # noqa: E731 (one of two)
                if self.peek() == ":=":
                    self.take(":=")
                    given = self.condition()
                values.append(lambda name=name, given=given: (name, given()))
            if self.at_end() or self.peek() in (")", "]"):
                return values
            if values:
                self.take(",")
            values.append(self.condition())

    def condition(self) -> Code:
        """Comparisons joined by AND only or OR only, which the languages rank differently."""
        left = self.negation()
        word = self.peek()
        while self.peek() in ("AND", "OR"):
            assert self.take("AND", "OR") == word, f"AND beside OR: {self.text}"
            left = self._joined(left, word, self.negation())
        return left

    def _joined(self, left: Code, word: str, right: Code) -> Code:
        def run() -> Value:
            one, other = left().get(), right().get()
            assert isinstance(one, bool) and isinstance(other, bool), self.text
            return Value("bool", one and other if word == "AND" else one or other)

        return run

    def negation(self) -> Code:
        """NOT applied to a name or to parentheses."""
        if self.peek() != "NOT":
            return self.comparison()
        self.take("NOT")
        of = self.primary()

        def run() -> Value:
            value = of().get()
            assert isinstance(value, bool), self.text
            return Value("bool", not value)

        return run

    def comparison(self) -> Code:
        """At most one comparison."""
        left = self.sum()
        mark = self.peek()
        if mark not in (*COMPARED, self.program.equals):
            return left
        self.at += 1
        right = self.sum()
        compare = COMPARED.get(mark, lambda a, b: a == b)

        def run() -> Value:
            one, other = left().get(), right().get()
            kinds = {type(one), type(other)}
            assert len(kinds) == 1 or kinds == {int, float}, f"{one!r} against {other!r}: {self.text}"
            return Value("bool", compare(one, other))

        return run

    def sum(self) -> Code:
        """Terms joined by + or -."""
        left = self.term()
        while self.peek() in ("+", "-"):
            left = self._computed(left, self.take("+", "-"), self.term())
        return left

    def term(self) -> Code:
        """Factors joined by *, /, DIV or MOD."""
        left = self.factor()
        while self.peek() in ("*", "/", "DIV", "MOD"):
            left = self._computed(left, self.take("*", "/", "DIV", "MOD"), self.factor())
        return left

    def _computed(self, left: Code, mark: str, right: Code) -> Code:
        return lambda: self.computed(left().get(), mark, right().get())

    def computed(self, a: Any, mark: str, b: Any) -> Value:
        """Result of an operator: texts are joined, integers stay integers, others are rounded to 32 bits."""
        if isinstance(a, str) and isinstance(b, str) and mark == "+":
            return Value("text", self.program.types.fitted("text", a + b))
        assert not isinstance(a, (bool, str)) and not isinstance(b, (bool, str)), self.text
        if mark in ("DIV", "MOD"):
            assert float(a).is_integer() and float(b).is_integer() and a >= 0 and b > 0, self.text
            return Value("", a // b if mark == "DIV" else a % b)
        if isinstance(a, int) and isinstance(b, int):
            if mark == "/":  # KRL: an integer for integers; KAREL has DIV for that
                assert self.program.equals == "==", f"/ of whole numbers: {self.text}"
                return Value("", int(a / b))
            result = a + b if mark == "+" else a - b if mark == "-" else a * b
            assert abs(result) < 2**31, f"overflow: {self.text}"
            return Value("", result)
        if mark == "/":
            return Value("", single(a / b if b else 0.0))
        return Value("", single(a + b if mark == "+" else a - b if mark == "-" else a * b))

    def factor(self) -> Code:
        """Optional sign and a primary."""
        if self.peek() != "-":
            return self.primary()
        self.take("-")
        of = self.primary()

        def run() -> Value:
            value = of().get()
            assert isinstance(value, (int, float)) and not isinstance(value, bool)
            return Value("", -value)

        return run

    def primary(self) -> Code:
        """A literal, a variable with indices and fields, a call, or parentheses."""
        kind, text = self.tokens[self.at]
        self.at += 1
        if kind == "number":
            return _constant("", int(text) if text.isdigit() else single(float(text)))
        if kind == "text":
            return _constant("text", self.program.types.fitted("literal", text))
        if text == "(":
            inner = self.condition()
            self.take(")")
            return lambda: Value((value := inner()).type, value.get())
        if text == "#":
            self.at += 1
            return _constant("enum", "#" + self.tokens[self.at - 1][1].upper())
        assert kind == "name", f"{text} in {self.text}"
        if text.upper() in ("TRUE", "FALSE"):
            return _constant("bool", text.upper() == "TRUE")
        if self.peek() == "(":
            self.take("(")
            arguments = [] if self.peek() == ")" else self.list_of_values()
            self.take(")")
            return lambda: Value("", self.program.invoke(text, [one() for one in arguments]))
        return self._parts(text.upper())

    def _parts(self, name: str) -> Code:
        opening, closing = self.program.index
        steps: list[Callable[[Any], Any]] = []
        while self.peek() in (opening, "."):
            if self.take(opening, ".") == ".":
                field_name = self.tokens[self.at][1].lower()
                self.at += 1
                steps.append(lambda place, one=field_name: place.get().fields[one])
            elif self.peek() == closing:  # KRL: the whole array
                self.take(closing)
            else:
                index = self.condition()
                steps.append(lambda place, index=index: place.element(index().get()))
                self.take(closing)
        named = self.program.named
        if not steps:
            return lambda: named(name)

        def run() -> Any:
            place = named(name)
            for step in steps:
                place = step(place)
            return place

        return run


def _constant(kind: str, value: Any) -> Code:
    made = Value(kind, value)
    return lambda: made
