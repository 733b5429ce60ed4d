"""Prints how much of each package the tests reach, from the data of `coverage combine`.

Kernels are compiled and not counted: the tests compare them with their twins in tests/naive.
"""

from __future__ import annotations

import json
import tempfile
from collections import Counter, defaultdict
from pathlib import Path, PurePath

import coverage

COUNTS = ("num_statements", "covered_lines", "num_branches", "covered_branches")


def share(part: int, whole: int) -> str:
    """Percentage; "" if there is nothing to reach."""
    return f"{100 * part / whole:.1f} %" if whole else ""


def main() -> None:
    """Print the table."""
    data = coverage.Coverage()
    data.load()
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "coverage.json"
        data.json_report(outfile=str(report))
        files = json.loads(report.read_text())["files"]
    packages: dict[str, Counter[str]] = defaultdict(Counter)
    for path, file in files.items():
        packages[str(PurePath(path).parent).replace("/", ".")].update({n: file["summary"][n] for n in COUNTS})
    rows = [*sorted(packages.items()), ("together", sum(packages.values(), Counter()))]
    print(f"{'package':28}{'statements':>10}{'reached':>10}{'branches':>10}{'reached':>10}")
    for name, counts in rows:
        statements, lines, branches, taken = (counts[count] for count in COUNTS)
        print(
            f"{name:28}{statements:10}{share(lines, statements):>10}{branches:10}{share(taken, branches):>10}"
        )


if __name__ == "__main__":
    main()
