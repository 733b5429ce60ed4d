"""Files beside a rig that hold choices made on the page: read within bounds, and parsed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from edged.config.fields import Section
from edged.errors import ConfigError
from edged.owners import file_to_read

MAX_BYTES = 64 * 1024
Choice = TypeVar("Choice", bound=Section)


def read_choice(file: Path, what: str) -> bytes | None:
    """Content of such a file; None without one. what : is chosen, for messages. Raises `ConfigError`."""
    try:
        with file_to_read(file) as opened:
            content = opened.read(MAX_BYTES + 1)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ConfigError(str(file), [f"{file.name}: cannot be read: {error.strerror or error}"]) from error
    if len(content) > MAX_BYTES:
        raise ConfigError(str(file), [f"{file.name}: larger than 64 KiB: no chosen {what}"])
    return content


def choice_of(model: type[Choice], content: bytes, file: Path, what: str, without: str) -> Choice:
    """Parse such content. without : effect of removing the file, for messages. Raises `ConfigError`."""
    try:
        return model.model_validate(json.loads(content))
    except (ValueError, RecursionError) as error:
        # the daemon wrote the file: an error means that it is damaged, not mistyped
        why = error.errors()[0]["msg"] if isinstance(error, ValidationError) else "not JSON"
        problem = f"{file.name}: no chosen {what}: {why}; remove it, and {without}"
        raise ConfigError(str(file), [problem]) from error
