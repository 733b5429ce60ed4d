"""Every command with its arguments and options, from the signatures that typer reads."""

from __future__ import annotations

import inspect
import re
import types
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer
from typer.models import ArgumentInfo, OptionInfo

from edged.cli.main import app
from referencepages.markdown import code, number, table

KINDS = {Path: "PATH", str: "TEXT", int: "INTEGER", float: "NUMBER"}


@dataclass(frozen=True, slots=True)
class Parameter:
    """names : as typed.  kind : of value, "" for a switch.  bounds, default : in words."""

    names: tuple[str, ...]
    kind: str
    help: str
    bounds: str
    default: str
    required: bool
    repeats: bool

    @property
    def is_option(self) -> bool:
        """Whether its name begins with a dash."""
        return self.names[0].startswith("-")


@dataclass(frozen=True, slots=True)
class Command:
    """One command, under its heading of `edged --help`."""

    name: str
    panel: str
    help: str
    parameters: tuple[Parameter, ...]


def commands() -> Iterator[Command]:
    """All commands, in the order of `edged --help`."""
    yield from _below(typer.main.get_command(app), "edged")


def _below(group: Any, prefix: str) -> Iterator[Command]:
    for name, one in group.commands.items():
        if hasattr(one, "commands"):
            yield from _below(one, f"{prefix} {name}")
        else:
            panel = one.rich_help_panel or group.rich_help_panel
            yield Command(f"{prefix} {name}", panel, one.help or "", tuple(_parameters(one)))


def _parameters(command: Any) -> Iterator[Parameter]:
    hints = typing.get_type_hints(inspect.unwrap(command.callback), include_extras=True)
    for one in command.params:
        annotation, info = typing.get_args(hints[one.name])[:2]
        plain, repeats = _plain(annotation)
        is_option = isinstance(info, OptionInfo)
        yield Parameter(
            (*one.opts, *one.secondary_opts) if is_option else (one.name.upper(),),
            KINDS.get(plain, ""),
            info.help or "",
            _bounds(info),
            _default(one.default, one.opts[0]),
            one.required,
            repeats,
        )


def _plain(annotation: object) -> tuple[object, bool]:
    """The kind of one value, and whether there may be several."""
    if isinstance(annotation, types.UnionType):
        (annotation,) = (one for one in typing.get_args(annotation) if one is not types.NoneType)
    if typing.get_origin(annotation) is list:
        return typing.get_args(annotation)[0], True
    return annotation, False


def _bounds(info: ArgumentInfo | OptionInfo) -> str:
    low, high = info.min, info.max
    if low is not None and high is not None:
        return f"{number(low)} to {number(high)}"
    return f"{number(low)} or more" if low is not None else ""


def _default(default: object, name: str) -> str:
    """Default value as it would be typed; "" if it may be left out."""
    if isinstance(default, bool):
        return code(name) if default else ""
    return "" if default in (None, "") else code(default)


def _usage(command: Command) -> str:
    arguments = [one for one in command.parameters if not one.is_option]
    options = [one for one in command.parameters if one.is_option]
    words = [command.name]
    words += [one.names[0] if one.required else f"[{one.names[0]}]" for one in arguments]
    words += [f"{one.names[0]} {one.kind}" for one in options if one.required]
    return " ".join([*words, "[OPTIONS]"] if any(not one.required for one in options) else words)


def _row(one: Parameter) -> tuple[str, str, str]:
    typed = ", ".join(code(name) for name in one.names) + (
        f" {one.kind}" if one.is_option and one.kind else ""
    )
    repeat = "repeat" if one.repeats and "repeat" not in one.help else ""
    told = "; ".join(part for part in (one.help, one.bounds, repeat) if part)
    return typed, "required" if one.required else one.default, told


def all_commands() -> str:
    """A section for each command, below those of `edged --help`."""
    parts: list[str] = []
    panel = ""
    for command in commands():
        if command.panel != panel:
            panel = command.panel
            parts.append(f"## {panel}")
        parts += [f"### {command.name}", re.sub(r":  (edged .+)", r": `\1`", command.help)]
        parts.append(f"```console\n{_usage(command)}\n```")
        if command.parameters:
            parts.append(table(("argument or option", "default", "meaning"), map(_row, command.parameters)))
    return "\n\n".join(parts)


PARTS = {"commands": all_commands}
