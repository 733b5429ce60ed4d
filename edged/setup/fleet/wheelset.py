"""A software release: edged's own wheel and those of all its dependencies, by name, version and SHA-256.

Its bill of materials, in CycloneDX, is signed; each wheel is a separate target with its own hash, so that
cells fetch only missing ones. `bom` makes the bill; this module reads it.
"""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from typing import Annotated
from urllib.parse import parse_qs, urlsplit

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from edged.config.reading import problem_of
from edged.errors import FileFormatError

WHEEL = re.compile(r"[A-Za-z0-9_.+!-]{1,200}\.whl")
OWN = "edged"


class _Read(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class _Hash(_Read):
    alg: str
    content: Annotated[str, Field(pattern=r"^[0-9a-f]{8,128}$")]


class _Component(_Read):
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$")]
    version: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+!-]{0,99}$")]
    purl: str = ""
    hashes: tuple[_Hash, ...] = ()


class _Bom(_Read):
    components: Annotated[tuple[_Component, ...], Field(min_length=1, max_length=1000)]


class Wheel(_Read):
    """A wheel of a release. sha256 : of its content."""

    name: str
    version: str
    file: Annotated[str, Field(pattern=f"^{WHEEL.pattern}$")]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]

    def target(self, plant: str) -> str:
        """Path in the repository; a file that several releases share is stored once."""
        return str(PurePosixPath(plant, f"{self.sha256}.{self.file}"))


def wheels_in(data: bytes, place: str) -> tuple[Wheel, ...]:
    """The wheels of a bill of materials. Raises `FileFormatError`."""
    try:
        found = tuple(_wheel(component) for component in _Bom.model_validate_json(data).components)
    except (ValidationError, StopIteration, KeyError) as error:
        why = (
            problem_of(error.errors()[0], _Bom)
            if isinstance(error, ValidationError)
            else "a component without SHA-256, or without the name of its file"
        )
        raise FileFormatError(f"{place}: no release of software: {why}") from error
    if OWN not in {wheel.name for wheel in found}:
        raise FileFormatError(f"{place}: no release of software: {OWN} is not in it")
    return found


def requirements(wheels: tuple[Wheel, ...]) -> str:
    """Requirements file for pip, which then accepts exactly these files."""
    return "".join(f"{wheel.name}=={wheel.version} --hash=sha256:{wheel.sha256}\n" for wheel in wheels)


def _wheel(component: _Component) -> Wheel:
    file = parse_qs(urlsplit(component.purl).query)["file_name"][0]
    digest = next(entry.content for entry in component.hashes if entry.alg == "SHA-256")
    return Wheel(name=component.name, version=component.version, file=file, sha256=digest)
