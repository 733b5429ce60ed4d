"""Reading of the configuration file, with mistakes explained in terms of the file."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from edged.config.cell import LimitsSection, MarksSection
from edged.config.chosencameras import chosen_file, chosen_of, read_chosen
from edged.config.chosenconnections import connections_file, connections_of, read_connections
from edged.config.configuration import Config
from edged.config.tomltext import MAX_TOML_BYTES, toml_of
from edged.errors import ConfigError
from edged.owners import file_to_read

EXPECTED = {
    "float_type": "expected a number",
    "float_parsing": "expected a number",
    "finite_number": "expected a finite number",
    "int_type": "expected a whole number",
    "int_from_float": "expected a whole number",
    "bool_type": "expected true or false",
    "string_type": 'expected a text in "quotes"',
    "list_type": "expected a list in [brackets]",
    "dict_type": "expected a table",
    "model_type": "expected a table",
    "greater_than": "expected more than {gt:g}",
    "greater_than_equal": "expected at least {ge:g}",
    "less_than": "expected less than {lt:g}",
    "less_than_equal": "expected at most {le:g}",
    "multiple_of": "expected a multiple of {multiple_of:g}",
    "literal_error": "expected {expected}",
    "string_too_short": "expected a text that is not empty",
    "string_pattern_mismatch": "expected 1 to 64 letters, digits, '_', '.' and '-', a letter or digit first",
}
"""Messages for pydantic's error types, in words for the person who writes the file."""


def _known_keys(model: type[BaseModel], path: Sequence[int | str]) -> list[str]:
    """Keys of the section at a path; empty if it is not a section with fixed keys."""
    for part in path:
        if isinstance(part, int):
            return []
        field = model.model_fields.get(part)
        inner = () if field is None else (field.annotation, *get_args(field.annotation))
        models = [kind for kind in inner if isinstance(kind, type) and issubclass(kind, BaseModel)]
        if not models:
            return []
        model = models[0]
    return [field.alias or name for name, field in model.model_fields.items()]


def load(path: Path) -> Config:
    """Read and check a configuration file.

    Raises `ConfigError` with one line for each mistake. Files that the configuration names are
    not opened here; `edged check` and the daemon do that.
    """
    path = Path(path)
    return config_of(read(path), path)


def read(path: Path) -> bytes:
    """Read the bytes of a configuration file. Raises `ConfigError`."""
    try:
        with file_to_read(path) as file:
            content = file.read(MAX_TOML_BYTES + 1)  # bounded, as a device has no size and no end
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror or error}"]) from error
    if len(content) > MAX_TOML_BYTES:
        raise ConfigError(str(path), ["larger than 1 MiB: not a configuration"])
    return content


def config_of(content: bytes, path: Path) -> Config:
    """Parse the content of a configuration file; raises as `load`. path : of the file, for relative paths."""
    config, _ = config_and_choice(content, path)
    return config


def config_and_choice(content: bytes, path: Path) -> tuple[Config, bytes | None]:
    """Configuration with the choices of the page applied, and the content of the file of chosen cameras."""
    data = _tables(content, path)
    configured = _validated(data, path, str(path))
    chosen = read_chosen(configured.cell.rig)
    return _chosen(data, path, configured, read_connections(configured.cell.rig), chosen), chosen


def config_with(content: bytes, path: Path, connections: bytes | None) -> Config:
    """Configuration as it would be with other connections and settings than those now chosen.

    connections : content of their file; None: as configured. Raises as `load`.
    """
    data = _tables(content, path)
    configured = _validated(data, path, str(path))
    return _chosen(data, path, configured, connections, read_chosen(configured.cell.rig))


def _tables(content: bytes, path: Path) -> dict[str, Any]:
    try:
        return toml_of(content)
    except UnicodeDecodeError as error:
        raise ConfigError(str(path), [not_utf8(error)]) from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(str(path), [not_toml(error, content)]) from error
    except RecursionError:
        raise ConfigError(str(path), ["not a configuration: nested too deeply"]) from None


def _chosen(
    data: dict[str, Any], path: Path, configured: Config, connections: bytes | None, cameras: bytes | None
) -> Config:
    """Configuration with the choices in the files of connections and of cameras applied."""
    rig, config = configured.cell.rig, configured
    if connections is not None:
        file = connections_file(rig)
        data = connections_of(connections, file).over(data)
        config = _validated(data, path, f"{path} with {file}")
    if cameras is not None:
        file = chosen_file(rig)
        data = {**data, "cameras": chosen_of(cameras, file).over(data.get("cameras", {}))}
        config = _validated(data, path, f"{path} with {file}")
    return config


def _validated(data: dict[str, Any], path: Path, source: str) -> Config:
    try:
        return Config.model_validate(data, context={"directory": path.resolve().parent})
    except ValidationError as error:
        raise ConfigError(source, [problem_of(detail, Config) for detail in error.errors()]) from error


def limits_of(content: bytes) -> LimitsSection:
    """`[limits]` of an earlier configuration, even if the rest of it is no longer valid.

    Raises `ValueError` if it is not a configuration.
    """
    data = toml_of(content)
    return LimitsSection.model_validate(data.get("limits", {}))


def marks_of_config(content: bytes) -> MarksSection:
    """`[marks]` of an earlier configuration. Raises `ValueError` as `limits_of`."""
    return MarksSection.model_validate(toml_of(content).get("marks", {}))


def not_utf8(error: UnicodeDecodeError) -> str:
    """Message for a file that is not UTF-8, with the line."""
    line = error.object.count(b"\n", 0, error.start) + 1
    return f"line {line}: not UTF-8 text (a byte 0x{error.object[error.start]:02x}): save it as UTF-8"


def not_toml(error: tomllib.TOMLDecodeError, content: bytes) -> str:
    """Message of the TOML parser, with the line that it did not understand."""
    message, lines = str(error), content.decode("utf-8-sig").splitlines()
    found = re.search(r" \(at line ([0-9]+), column [0-9]+\)$", message)
    if found is None or int(found[1]) > len(lines):
        return f"not TOML: {message}"
    return f"line {found[1]}: not TOML: {message[: found.start()]}, got {lines[int(found[1]) - 1].strip()!r}"


def problem_of(detail: Any, model: type[BaseModel]) -> str:
    """One line of `edged check` for a mistake that pydantic found when it validated a `model`.

    It has the dotted path, what is wrong, and what was expected and found.
    """
    place = ".".join(str(part) for part in detail["loc"]) or "(file)"
    if detail["type"] == "extra_forbidden":
        known = _known_keys(model, detail["loc"][:-1])
        close = difflib.get_close_matches(str(detail["loc"][-1]), known, 1)
        return f"{place}: unknown key" + (f", did you mean {close[0]}?" if close else "")
    if detail["type"] == "missing":
        return f"{place}: missing"
    form = EXPECTED.get(detail["type"])
    message = form.format(**detail.get("ctx", {})) if form else detail["msg"].removeprefix("Value error, ")
    if place.endswith("password_hash") or "private key" in message:  # what was found may be the secret
        return f"{place}: {message}"
    shown = repr(detail["input"])
    if isinstance(detail["input"], dict) or len(shown) > 60:
        return f"{place}: {message}"
    return f"{place}: {message}, got {shown}"
