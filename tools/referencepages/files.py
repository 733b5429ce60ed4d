"""Content of a cell's files, from the tables of the code that reads them."""

from __future__ import annotations

from collections.abc import Iterator

from edged.config.tomltext import MAX_KEY_PARTS, MAX_TOML_BYTES
from edged.files import atomic, dxf, images, step, stl, tables
from edged.files.jobs.schema import JobFile
from edged.files.rigformats.files import MAX_NODES, MAX_TEXT_BYTES
from edged.setup.releases import archive
from edged.vision.geometry.camera import DISTORTION_NAMES
from edged.vision.part.job import MEASURES
from referencepages.configuration import HEAD, body, heading, rows, sections
from referencepages.markdown import code, table


def distortions() -> str:
    """Distortion parameters of each lens model."""
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
    """Requirements of each kind of measurement."""
    return table(("`kind`", "`of`"), _measures())


def _measures() -> Iterator[tuple[str, str]]:
    for kind, wanted in MEASURES.items():
        yield code(kind), "; ".join(" or ".join(allowed) for allowed in wanted) or "nothing: the whole face"


def bounds() -> str:
    """Maximum content of a file, according to its reader."""
    return table(
        ("file", "at most"),
        (
            ("a picture", f"{images.MAX_PIXELS:,} pixels, {_mib(images.MAX_UNPACKED_BYTES)} unpacked"),
            ("rig, document of a recording, result of `edged locate`", _mib(atomic.MAX_DOCUMENT_BYTES)),
            ("configuration, `job.toml`", f"{_mib(MAX_TOML_BYTES)}, {MAX_KEY_PARTS} parts of a key"),
            ("recording, `shape.npz`", f"{_mib(atomic.MAX_FILE_BYTES)} unpacked, deflated or stored"),
            ("backup", f"{_mib(archive.MAX_BYTES)} unpacked, {archive.MAX_MEMBERS:,} files"),
            (
                "DXF drawing",
                f"{_mib(dxf.MAX_DRAWING_BYTES)}; with all blocks that are placed {dxf.MAX_ENTITIES:,} shapes "
                f"and {dxf.MAX_POINTS:,} points; {dxf.MAX_FIT_POINTS:,} points that a spline goes through, "
                f"{dxf.MAX_ALL_FIT_POINTS:,} in all",
            ),
            ("STL model", f"{stl.MAX_FACETS:,} facets"),
            (
                "STEP model",
                f"{step.MAX_FACES:,} faces; {_mib(step.MAX_MEMORY_BYTES)}, {step.MAX_SECONDS} s to read it",
            ),
            (
                "table of points or poses, contour",
                f"{_mib(tables.MAX_TEXT_BYTES)}, {tables.MAX_LINES:,} lines",
            ),
            ("camera parameters in YAML", f"{MAX_TEXT_BYTES:,} bytes, {MAX_NODES:,} values with all aliases"),
            ("any other", _mib(atomic.MAX_FILE_BYTES)),
        ),
    )


def _mib(count: int) -> str:
    return f"{count >> 20:,} MiB"


PARTS = {"bounds": bounds, "distortions": distortions, "job": job_keys, "measures": measures}
