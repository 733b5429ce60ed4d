"""What stands in the files of a cell, from the tables of those that read them."""

from __future__ import annotations

from collections.abc import Iterator

from edged.files.jobs.schema import JobFile
from edged.vision.geometry.camera import DISTORTION_NAMES
from edged.vision.part.job import MEASURES
from referencepages.configuration import HEAD, body, heading, rows, sections
from referencepages.markdown import code, table


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
    parts = [table(HEAD, rows(JobFile, schema))]
    for path, model, is_list in sections(JobFile):
        if path != "limits.keep_out":
            parts += [f"#### {heading(path, is_list)}", *body(model, definitions[model.__name__])]
        else:
            parts[-3] += f", {heading(path, is_list)}"  # the same table twice
    return "\n\n".join(parts)


def measures() -> str:
    """What each kind of measurement needs."""
    return table(("`kind`", "`of`"), _measures())


def _measures() -> Iterator[tuple[str, str]]:
    for kind, wanted in MEASURES.items():
        yield code(kind), "; ".join(" or ".join(allowed) for allowed in wanted) or "nothing: the whole face"


PARTS = {"distortions": distortions, "job": job_keys, "measures": measures}
