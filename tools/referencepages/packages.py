"""The packages of edged: permitted imports according to `[tool.importlinter]`, and purposes."""

from __future__ import annotations

import ast
import tomllib

from referencepages.markdown import ROOT, code, table


def _layers(container: str) -> list[list[str]]:
    """The packages of a container, topmost layer first."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (layers,) = (one["layers"] for one in contracts if one.get("containers") == [container])
    return [layer.split(" | ") for layer in layers]


def _purpose(module: str) -> str:
    """The first line of a module's docstring."""
    path = ROOT.joinpath(*module.split("."))
    source = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return (ast.get_docstring(ast.parse(source.read_text())) or "").partition("\n")[0].removesuffix(".")


def layers() -> str:
    """Both layered containers, as a drawing."""
    lines = [
        f"{container}/\n" + "\n".join(f"  {' | '.join(layer)}" for layer in _layers(container))
        for container in ("edged", "edged.vision")
    ]
    return "```text\n" + "\n\n".join(lines) + "\n```"


def _layer_table(container: str) -> str:
    rows = [
        (number if name == layer[0] else "", code(name), _purpose(f"{container}.{name}"))
        for number, layer in enumerate(_layers(container), 1)
        for name in layer
    ]
    return table(("layer", "package", "what it is"), rows, numbers=1)


def _member_table(container: str) -> str:
    """A table of a container's packages, if it has no layers."""
    packages = sorted(ROOT.joinpath(*container.split(".")).glob("*/__init__.py"))
    names = (package.parent.name for package in packages)
    return table(("package", "what it is"), ((code(name), _purpose(f"{container}.{name}")) for name in names))


CONTRIBUTING = {"layers": layers}
ARCHITECTURE = {
    "packages": lambda: _layer_table("edged"),
    "vision": lambda: _layer_table("edged.vision"),
    "setup": lambda: _member_table("edged.setup"),
    "adapters": lambda: _member_table("edged.adapters"),
}
