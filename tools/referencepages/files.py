"""What stands in the files of a cell, from the tables of those that read them."""

from __future__ import annotations

from collections.abc import Iterator

from edged.files.jobs.schema import JobFile
from edged.vision.geometry.camera import DISTORTION_NAMES
from edged.vision.part.job import MEASURES
from referencepages.configuration import model_of, rows
from referencepages.markdown import code, first_line, table


def distortions() -> str:
    """What belongs to which lens model."""
    return table(
        ("`model`", "`distortion`"),
        ((code(model), ", ".join(map(code, names))) for model, names in DISTORTION_NAMES.items()),
    )


def job_keys() -> str:
    """A section for the file itself and for each table of it."""
    schema = JobFile.model_json_schema()
    definitions = schema["$defs"]
    head = ("key", "value", "default", "meaning")
    parts = [table(head, rows(JobFile, schema))]
    for name, field in JobFile.model_fields.items():
        model = model_of(field)
        if model is None:
            continue
        is_list = field.annotation is not model
        heading = f"[[{name}]]" if is_list else f"[{name}]"
        text = first_line(model) + "."
        parts += [f"#### {code(heading)}", text, table(head, rows(model, definitions[model.__name__]))]
    return "\n\n".join(parts)


def measures() -> str:
    """What each kind of measurement needs."""
    return table(("`kind`", "`of`"), _measures())


def _measures() -> Iterator[tuple[str, str]]:
    for kind, wanted in MEASURES.items():
        yield code(kind), "; ".join(" or ".join(allowed) for allowed in wanted) or "nothing: the whole face"


PARTS = {"distortions": distortions, "job": job_keys, "measures": measures}
