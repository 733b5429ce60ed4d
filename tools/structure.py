"""Counts what the code consists of: folders and their imports, names, tuned numbers, signatures, lines.

    python tools/structure.py [ROOT]

An import between folders is one folder of edged that imports from another; those of `edged.vision` count
one by one, and tools too. Lines are of code: without blank ones, comments and docstrings. The number of
files that a pair, a request and a click enter is in tests/tools/test_structure.py, which prints it with
`pytest -s`.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from collections import Counter
from pathlib import Path

MANY = 8
SPACE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def sources(folder: Path) -> dict[Path, str]:
    """Modules below a folder, and scripts whose first line names Python."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.suffix == ".py" or (path.is_file() and not path.suffix):
            text = path.read_bytes().decode("utf-8", "replace")
            if path.suffix or text.partition("\n")[0].endswith("python"):
                found[path] = text
    return found


def code_lines(text: str) -> int:
    """Number of lines with a token that is no comment and no docstring."""
    docs = {
        line
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
        for line in range(node.lineno, (node.end_lineno or 0) + 1)
    }
    lines = set[int]()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in SPACE:
            lines |= set(range(token.start[0], token.end[0] + 1))
    return len(lines - docs)


def package_of(root: Path, names: list[str]) -> str:
    """Folder of a module by its names from `edged` on: one below edged, two in vision; "" for none."""
    names = names[1:3] if names[1:2] == ["vision"] else names[1:2]
    return ".".join(names) if (root / "edged").joinpath(*names).is_dir() else ""


def imports(root: Path, trees: dict[Path, ast.Module]) -> set[tuple[str, str]]:
    """Pairs (importing, imported) of folders."""
    found = set[tuple[str, str]]()
    for path, tree in trees.items():
        parts = list(path.relative_to(root).with_suffix("").parts)
        mine = package_of(root, parts) if parts[0] == "edged" else parts[0]
        for node in ast.walk(tree):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            found |= {
                (mine, package_of(root, name.split("."))) for name in names if name.startswith("edged.")
            }
    return {(one, other) for one, other in found if one != other and one and other}


def layers(downwards: set[tuple[str, str]]) -> int:
    """Length of the longest path downwards."""
    below = {one: {other for first, other in downwards if first == one} for one, _ in downwards}

    def height(package: str) -> int:
        return 1 + max(map(height, below.get(package, ())), default=0)

    return max(map(height, below), default=0)


def parameters(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Number of parameters, without self."""
    names = [one.arg for one in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
    return len([name for name in names if name not in ("self", "cls")])


def numbers(trees: dict[Path, ast.Module], texts: dict[Path, str]) -> tuple[int, int, int]:
    """Constants with numbers in vision: all, those in a class of parameters, those without a comment."""
    every = held = bare = 0
    for path, tree in trees.items():
        lines = texts[path].splitlines()
        for owner in ast.walk(tree):
            if not isinstance(owner, ast.Module | ast.ClassDef):
                continue
            described = (ast.get_docstring(owner) or "").replace(",", " ").split()
            for node, after in zip(owner.body, [*owner.body[1:], None], strict=True):
                value = getattr(node, "value", None)
                is_number = value is not None and any(
                    isinstance(one, ast.Constant) and type(one.value) in (int, float)
                    for one in ast.walk(value)
                )
                if isinstance(node, ast.Assign | ast.AnnAssign) and is_number:
                    every += 1
                    held += isinstance(owner, ast.ClassDef)
                    said = isinstance(after, ast.Expr) or "#" in lines[(node.end_lineno or 0) - 1]
                    name = ast.unparse(node.target if isinstance(node, ast.AnnAssign) else node.targets[0])
                    bare += not said and name not in described
    return every, held, bare


def main(root: Path) -> None:
    """Print the table."""
    texts = {
        path: text for name in ("edged", "tests", "tools") for path, text in sources(root / name).items()
    }
    trees = {path: ast.parse(text) for path, text in texts.items()}
    of = {
        name: [path for path in texts if path.relative_to(root).parts[0] == name]
        for name in ("edged", "tests", "tools")
    }
    product = {path: trees[path] for path in of["edged"]}
    downwards = imports(root, {path: trees[path] for path in (*of["edged"], *of["tools"])})
    folders = len({folder for pair in downwards for folder in pair})
    size = f"{folders} in {layers(downwards)} layers, {len(downwards)} imports between them"
    print(f"folders of edged with tools: {size}")
    classes = Counter(
        node.name
        for tree in product.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    print(f"public class names that stand in several modules: {sum(n > 1 for n in classes.values())}")
    vision = {path: tree for path, tree in product.items() if "vision" in path.parts}
    every, held, bare = numbers(vision, texts)
    print(f"constants with numbers in vision: {every}, {held} in classes, {bare} without a comment")
    functions = [
        node
        for tree in product.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    wide = [node.name for node in functions if parameters(node) > MANY]
    print(f"functions of edged: {len(functions)}, with more than {MANY} parameters: {len(wide)}")
    for name, paths in of.items():
        whole = sum(len(texts[path].splitlines()) for path in paths)
        code = sum(code_lines(texts[path]) for path in paths)
        print(f"{name}: {len(paths)} files, {code} lines of code, {whole} in all")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).parents[1])
