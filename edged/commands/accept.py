"""`edged accept`: acceptance test of a cell on site, from what a person shows it; with a page to sign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from edged.commands.saying import print_safe
from edged.domain.acceptance import Acceptance
from edged.errors import UserError
from edged.files.acceptance import acceptance_file
from edged.files.atomic import write_file
from edged.files.jobs import load_job
from edged.files.outputs import check_folder
from edged.files.rig import load_rig
from edged.owners import as_owner
from edged.setup.acceptance.accepting import VERDICTS, StatedTruth, accepted, documents_of
from edged.setup.acceptance.verdicts import AcceptanceTest
from edged.setup.releases.signing import signature_file, signature_of


@dataclass(frozen=True, slots=True)
class Signed:
    """Who signs. key : private, PEM; None: signed only by hand, on the page."""

    by: str = ""
    key: Path | None = None


def accept(
    folder: Path,
    rig_path: Path,
    job_path: Path,
    output: Path,
    shown: StatedTruth,
    console: Console,
    *,
    signed: Signed | None = None,
    as_json: bool = False,
) -> int:
    """Run the tests that `folder` contains: still/, pose/, length/, robot/. 0: passed; 1: not.

    Writes acceptance.json, .html and .pdf to `output`, and the first beside the rig as well, where the cell
    reads it. Raises `UserError`.
    """
    rig, job = load_rig(rig_path), load_job(job_path)
    check_folder(output)
    check_folder(rig_path.resolve().parent)
    if not folder.is_dir():
        raise UserError(f"{folder}: not a folder; expected still/, pose/, length/, robot/ in it")
    by = Signed() if signed is None else signed
    tests = accepted(folder, rig, job, shown)
    made = documents_of(tests, (rig, str(rig_path)), job, by.by, shown.days)
    signature = None if by.key is None else signature_of(made.document, by.key)
    output.mkdir(parents=True, exist_ok=True)
    write_file(output / "acceptance.json", made.document)
    write_file(output / "acceptance.html", made.html)
    write_file(output / "acceptance.pdf", made.pdf)
    if signature is not None:
        write_file(signature_file(output / "acceptance.json"), signature[0])
    with as_owner(rig_path.resolve().parent) as place:
        write_file(acceptance_file(place / rig_path.name), made.document)
    if as_json:
        print(made.document.decode(), end="")
    else:
        _tell(tests, made.found, output, None if signature is None else signature[1], console)
    return 0 if made.found.passed else 1


def _tell(
    tests: Sequence[AcceptanceTest], found: Acceptance, output: Path, signer: str | None, console: Console
) -> None:
    for test in tests:
        print_safe(f"{test.name}: {VERDICTS[test.good]}{f' - {test.why}' if test.why else ''}", console)
        for name, value in test.figures.items():
            print_safe(f"  {name}: {value}", console)
    verdict = "passed" if found.passed else "not passed"
    print_safe(f"the cell has {verdict}; {output}/acceptance.html and .pdf are the page to sign", console)
    if signer is not None:
        print_safe(f"signed with the key {signer}: {signature_file(output / 'acceptance.json')}", console)
