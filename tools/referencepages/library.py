"""The library's functions, and the types that they take and return, from their docstrings."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Iterator, Set

import edged
from edged import library
from edged.domain.measurement import Circle3D, Match, Nearest, NearMiss, Outcome, Target
from edged.setup.calibration.views import Calibrated
from edged.vision.calibration.verdict import CalibrationVerdict
from edged.vision.geometry.camera import StereoRig
from edged.vision.part.job import Job
from edged.vision.teaching.region import CircleRegion, Painted, PolygonRegion, Region, Stroke
from referencepages.markdown import code, first_line, table

TYPES = (
    *(Outcome, Target, Match, Circle3D, Nearest, NearMiss, Calibrated, CalibrationVerdict, StereoRig, Job),
    *(Region, CircleRegion, PolygonRegion, Stroke, Painted),
)
FIELD = re.compile(r"(?:^|(?<=\. ))(?P<names>\w+(?:, \w+)*)(?P<shape> \([^)]*\))? ?: ")
"""How docstrings introduce an explanation: "left, right : images", at the beginning of a sentence."""


def functions() -> str:
    """Each function with its signature and its arguments."""
    return "\n\n".join(_function(name) for name in edged.__all__)


def _function(name: str) -> str:
    function = getattr(library, name)
    signature = inspect.signature(function)
    said, meanings = _explained(function, signature.parameters.keys())
    rows = [(code(one), meanings.get(one, "")) for one in signature.parameters]
    arguments = [table(("argument", "meaning"), rows)] if meanings else []
    return "\n\n".join([f"### {name}", f"```python\n{_call(name, signature)}\n```", *said, *arguments])


def _call(name: str, signature: inspect.Signature) -> str:
    arguments = list(_arguments(signature))
    line = f"{name}({', '.join(arguments)}) -> {signature.return_annotation}"
    if len(line) <= 100:
        return line
    inside = "".join(f"    {argument},\n" for argument in arguments)
    return f"{name}(\n{inside}) -> {signature.return_annotation}"


def _arguments(signature: inspect.Signature) -> Iterator[str]:
    starred = False
    for one in signature.parameters.values():
        if one.kind is one.KEYWORD_ONLY and not starred:
            starred = True
            yield "*"
        yield f"{one.name}: {one.annotation}{'' if one.default is one.empty else f' = {one.default!r}'}"


def types() -> str:
    """Each type with its module, its fields and the values computed from them."""
    return "\n\n".join(_type(kind) for kind in TYPES)


def _type(kind: type) -> str:
    fields = (
        {one.name: one.type for one in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else {}
    )
    said, meanings = _explained(kind, fields.keys())
    rows = [(code(name), code(of), meanings.get(name, "")) for name, of in fields.items()]
    for name, one in vars(kind).items():
        function = one.fget if isinstance(one, property) else one
        if not name.startswith("_") and inspect.isfunction(function):
            shown = name if isinstance(one, property) else f"{name}()"
            rows.append((code(shown), code(inspect.signature(function).return_annotation), first_line(one)))
    return "\n\n".join(
        [f"### {kind.__name__}", f"`{kind.__module__}`", *said, table(("name", "type", "meaning"), rows)]
    )


def _explained(thing: object, names: Set[str]) -> tuple[list[str], dict[str, str]]:
    """The paragraphs of a docstring, and its explanation of each of these names."""
    said, meanings = list[str](), dict[str, str]()
    for paragraph in (inspect.getdoc(thing) or "").split("\n\n"):
        text = " ".join(paragraph.split())
        fields = [one for one in FIELD.finditer(text) if set(one["names"].split(", ")) <= names]
        ends = [*(one.start() for one in fields), len(text)]
        if before := text[: ends[0]].strip():
            said.append(before)
        for field, end in zip(fields, ends[1:], strict=True):
            meaning = f"{(field['shape'] or '').strip()} {text[field.end() : end]}".strip().removesuffix(".")
            meanings |= dict.fromkeys(field["names"].split(", "), meaning)
    return said, meanings


PARTS = {"functions": functions, "types": types}
