"""`edged accept` and `edged study`: incomplete tests do not pass, and every wrong input is named."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat
from helpers.cells import flange, small_rig
from helpers.commandline import exit_code, printed

from edged.commands.demo import DemoOptions, prepare_cell
from edged.errors import UserError
from edged.setup.releases.signing import check_signature
from edged.sim.cell import VirtualCell, demo_part


def write_pairs(folder: Path, count: int) -> None:
    """Pairs of the small rig's flange, each with other noise."""
    folder.mkdir(parents=True)
    part, rng = flange(), np.random.default_rng(3)
    for number in range(count):
        for side, image in (("left", part.left), ("right", part.right)):
            noisy = np.clip(image + rng.normal(0, 1.0, image.shape), 0, 255).astype(np.uint8)
            cv2.imwrite(str(folder / f"p{number}_{side}.png"), noisy)


@pytest.mark.long
def test_a_cell_is_accepted_only_by_all_of_its_tests(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A still part alone does not pass the cell; the document is written and signed; wrong input is named."""
    prepare_cell(tmp_path, VirtualCell(small_rig(), demo_part(), seed=11), DemoOptions(), gige=False)
    shown, out, key, public = (tmp_path / name for name in ("shown", "out", "key.pem", "public.pem"))
    rig, job = tmp_path / "rig.json", tmp_path / "jobs/flange"
    private = Ed25519PrivateKey.generate()
    key.touch(0o600)
    key.write_bytes(private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    public.write_bytes(private.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    write_pairs(shown / "still", 50)
    given = ("--rig", rig, "--job", job, "-o", out)
    assert 1 == exit_code("accept", shown, *given, "--sign", key, "--by", "A. Tester", "--days", 30)
    words = printed(capsys)
    assert "still: passed" in words
    assert "pose: cannot be said - not made: nothing is in pose/" in words
    assert "the cell has not passed" in words
    kept = (tmp_path / "acceptance.json").read_bytes()
    assert kept == (out / "acceptance.json").read_bytes()
    assert json.loads(kept)["passed"] is False
    assert json.loads(kept)["by"] == "A. Tester"
    check_signature(kept, out / "acceptance.json", public)
    with pytest.raises(UserError, match="it was changed"):
        check_signature(kept.replace(b"false", b"true"), out / "acceptance.json", public)
    assert "still: passed" in (out / "acceptance.html").read_text()
    assert (out / "acceptance.pdf").read_bytes().startswith(b"%PDF")

    write_pairs(shown / "length", 1)
    assert 2 == exit_code("accept", shown, *given)
    assert "it is not stated what is measured there" in printed(capsys)
    assert 2 == exit_code("accept", shown, *given, "--length", "nothing=3")
    assert "length nothing: the job has" in printed(capsys)
    write_pairs(shown / "pose", 1)
    (shown / "pose/truth.csv").write_text("q,1,2,3\n")
    assert 2 == exit_code("accept", shown, *given)
    assert "no line for p0" in printed(capsys)
    assert 2 == exit_code("accept", tmp_path / "nowhere", *given)
    assert "not a folder; expected still/" in printed(capsys)
    assert kept == (tmp_path / "acceptance.json").read_bytes()


@pytest.mark.long
def test_a_study_of_a_size_says_whether_the_cell_is_fit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the mean of 25 pictures as reference the bore is capable, and with one 10 um beside it not."""
    prepare_cell(tmp_path, VirtualCell(small_rig(), demo_part(), seed=11), DemoOptions(), gige=False)
    folder, report = tmp_path / "study", tmp_path / "study.html"
    rig, job = tmp_path / "rig.json", tmp_path / "jobs/flange"
    write_pairs(folder / "master", 25)
    given = ("study", folder, "--rig", rig, "--job", job, "--size", "c0")
    asked = (*given, "--tolerance", "27.95:28.05", "--json")
    assert exit_code(*asked, "--reference", "28") in (0, 1)
    mean = json.loads(capsys.readouterr().out)["type1"]["mean_mm"]
    assert mean == pytest.approx(28.0, abs=0.01)
    assert 0 == exit_code(*asked, "--reference", mean, "--report", report)
    assert json.loads(capsys.readouterr().out)["type1"]["cgk"] > 1.33
    assert "Cg, Cgk" in report.read_text()
    assert 1 == exit_code(*asked, "--reference", mean + 0.01)
    capsys.readouterr()
    assert 2 == exit_code(*given, "--tolerance", "27.95:28.05")
    assert "--reference MM says how large the master is" in printed(capsys)
    assert 2 == exit_code(*given, "--tolerance", "28.05:27.95")
    assert "expected LOW:HIGH" in printed(capsys)
    assert 2 == exit_code("study", tmp_path / "jobs", *given[2:], "--tolerance", "27:28")
    assert "expected master/" in printed(capsys)
    (folder / "parts/one").mkdir(parents=True)
    assert 2 == exit_code(*given, "--tolerance", "27:28", "--reference", "28")
    assert "parts/one: 0 folders" in printed(capsys)
