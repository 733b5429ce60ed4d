"""Registration over HTTP, on a stage whose virtual robot states its exact pose."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.cells import small_rig
from helpers.stagecell import Newcomer, staged

from edged.domain.arrays import FloatArray
from edged.domain.events import Command, CommandKind
from edged.errors import BeingSetUp
from edged.files.rig import load_rig, save_rig
from edged.sim.robot import FLANGE_FROM_RIG
from edged.vision.geometry.rigid import apply

pytestmark = pytest.mark.slow
BOARD = "chessboard:11x8:4"
VOLUME_MM = np.array([[x, y, z] for x in (-16, 32) for y in (-16, 16) for z in (195, 215)], float)


def worst_um(found: FloatArray, true: FloatArray) -> float:
    """Largest error in the robot's frame within the working volume, in µm."""
    return 1000 * float(np.linalg.norm(apply(found, VOLUME_MM) - apply(true, VOLUME_MM), axis=1).max())


class Registrar:
    """A person at the robot who follows the page."""

    def __init__(
        self, newcomer: Newcomer, about: dict[str, Any], pendant: str = "kuka", noise_um: float = 10
    ):
        self.newcomer, self.about, self.pendant, self.noise_um = newcomer, about, pendant, noise_um
        self.place, self.document = "", {}

    async def begin(self) -> None:
        """Begin the registration."""
        self.document = await self.newcomer.ask("POST", "registrations", self.about, 201)
        self.place = f"registrations/{self.document['id']}"

    async def do(
        self, method: str, path: str, body: dict[str, Any] | None = None, expected: int = 200
    ) -> Any:
        """Make a change to the draft; returns its answer."""
        self.document = await self.newcomer.ask(method, f"{self.place}{path}", body or {}, expected)
        return self.document

    async def judged(self) -> dict[str, Any]:
        """The draft, once it is judged with all its samples."""
        self.document = await self.newcomer.until(self.place, lambda draft: not draft["judging"])
        return self.document

    async def shown(self, **where: float | str) -> dict[str, Any]:
        """What the robot's pendant shows."""
        query = {"brand": self.pendant, "noise_um": self.noise_um, **where}
        words = "&".join(f"{name}={value}" for name, value in query.items())
        return dict(await self.newcomer.ask("GET", f"stage/robot?{words}"))

    async def look(self, job: str | None = None) -> None:
        """Take a picture of the places to touch."""
        await self.do("POST", "/looks", {**self.newcomer.token, "job": job}, 201)

    async def touch(self, change: Callable[[list[float]], list[float]] = list) -> dict[str, Any]:
        """Touch the most wanted place. change : applied to the typed values."""
        place = next(one for one in self.document["places"] if one["wanted"])
        x, y = place["left"]
        numbers = change((await self.shown(x=x, y=y))["numbers"])
        return dict(await self.do("POST", "/samples", {"place": place["key"], "numbers": numbers}, 201))

    async def pose(self, carries: str = "board") -> dict[str, Any]:
        """Move the robot to its next pose, take a picture, and paste the shown pose."""
        await self.newcomer.ask("POST", "stage/robot/walk", {})
        text = (await self.shown(carries=carries))["text"]
        return dict(await self.do("POST", "/samples", {**self.newcomer.token, "text": text}, 201))


@asynccontextmanager
async def on_stage(folder: Path) -> AsyncIterator[Newcomer]:
    """A stage that shows its board to a calibrated cell without a robot's frame."""
    bare = replace(small_rig(), robot_from_rig=None)
    save_rig(folder / "rig.json", bare, {"board": BOARD})

    async with staged(folder, gige=False) as newcomer:
        await newcomer.ask("PUT", "stage", {"showing": "board", "still": True})
        await newcomer.ask("POST", "stage/robot/walk", {})
        yield newcomer


async def test_a_persons_draft_gets_its_samples_from_the_page_alone(tmp_path: Path) -> None:
    """Commands of a PLC or a robot's program are refused while a person has the cell."""
    async with on_stage(tmp_path) as newcomer:
        person = Registrar(newcomer, {"mount": "fixed", "kind": "poses", "brand": "kuka", "board": BOARD})
        await person.begin()
        for kind in CommandKind:
            with pytest.raises(BeingSetUp):
                newcomer.daemon._cycle.submit(  # noqa: SLF001  (as a client's)
                    Command(kind, "a PLC", 1, robot_from_flange=np.eye(4))
                )
        assert [] == (await person.judged())["samples"]


@pytest.mark.long
async def test_six_touches_give_the_robots_frame_and_the_place_to_go_to(tmp_path: Path) -> None:
    """Six touches with 10 µm of noise are right within 25 µm in the volume; a mistyped one is named until
    it is corrected; the result equals the command's. A board of wrong length cannot be touched."""
    async with on_stage(tmp_path) as newcomer:
        about = {"mount": "fixed", "kind": "touch", "brand": "kuka"}
        longer = Registrar(newcomer, {**about, "board": "chessboard:11x8:4.1"})
        await longer.begin()
        await longer.look()
        assert [] == longer.document["places"]
        assert -2.44 == pytest.approx(longer.document["look_length_percent"], abs=0.1)
        person = Registrar(newcomer, {**about, "board": BOARD})
        await person.begin()
        for step in range(6):
            if step % 3 == 0:
                if step:
                    await newcomer.ask("POST", "stage/robot/walk", {})
                await person.look()
                assert 9 == len(person.document["places"])
            await person.touch((lambda n: [n[0] + 3.0, *n[1:]]) if step == 2 else list)
        document = await person.judged()
        assert "point_003" == document["culprit"]
        assert ("culprit", "point_003") == (
            document["trouble"]["code"],
            document["trouble"]["params"]["name"],
        )
        assert 3.0 == pytest.approx(document["trouble"]["params"]["mm"], abs=0.15)
        refused = await newcomer.ask("POST", f"{person.place}/solve", {}, 422)
        assert "point_003 is wrong by" in refused["detail"]
        wrong = next(one for one in document["samples"] if one["name"] == "point_003")
        right = [wrong["numbers"][0] - 3.0, *wrong["numbers"][1:]]
        await person.do("PUT", "/samples/point_003", {"numbers": right})
        document = await person.judged()
        assert (True, None, None) == (document["good"], document["trouble"], document["culprit"])
        assert abs(document["figures"]["scale"] - 1) < 3 * document["figures"]["sigma_scale"]
        stale = {"revision": document["revision"] - 1}
        assert "stale" == (await newcomer.ask("POST", f"{person.place}/solve", stale, 412))["code"]
        document = await person.do("POST", "/solve")
        assert document["solved"] and not document["active"]

        # the target in the robot's numbers is where the mark truly is
        place = document["places"][4]
        x, y = place["left"]
        true = (await person.shown(x=x, y=y, noise_um=0))["numbers"]
        assert np.abs(np.array(true) - place["robot"]["numbers"]).max() < 0.03
        document = await person.do("POST", "/confirm", {"place": place["key"], "numbers": true})
        assert document["confirmed"]["distance_mm"] < 0.03

        before = (tmp_path / "rig.json").read_bytes()
        release = await newcomer.ask("POST", f"{person.place}/activate", {**newcomer.token, "note": "robot"})
        assert release["active"]
        assert (await newcomer.ask("GET", person.place))["active"]
        rig = load_rig(tmp_path / "rig.json")
        assert rig.robot_from_rig is not None and small_rig().robot_from_rig is not None
        assert worst_um(rig.robot_from_rig, small_rig().robot_from_rig) < 25
        check_same_digits(tmp_path, before, document, rig.robot_from_rig)


@pytest.mark.long
async def test_a_discarded_draft_is_gone_and_another_is_begun(tmp_path: Path) -> None:
    """A draft can be discarded while it is judged, with its latest revision, and the next one is
    independent."""
    async with on_stage(tmp_path) as newcomer:
        about = {"mount": "fixed", "kind": "touch", "brand": "kuka", "board": BOARD}
        person = Registrar(newcomer, about)
        await person.begin()
        await person.look()
        document = await person.touch()
        stale = {"revision": document["revision"] - 1}
        assert "stale" == (await newcomer.ask("DELETE", person.place, stale, 412))["code"]
        assert None is await newcomer.ask("DELETE", person.place, {"revision": document["revision"]}, 204)
        for method, path in (("GET", ""), ("DELETE", ""), ("POST", "/solve"), ("POST", "/undo")):
            assert "unknown" == (await newcomer.ask(method, person.place + path, {}, 404))["code"]
        assert [] == (await newcomer.ask("GET", "registrations"))["registrations"]

        await person.begin()
        assert [] == person.document["samples"]
        await person.look()
        await person.touch()
        assert 1 == len((await person.judged())["samples"])


def check_same_digits(folder: Path, rig: bytes, document: dict[str, Any], found: FloatArray) -> None:
    """Compare with `edged register touch` for the same points."""
    from rich.console import Console

    from edged.commands.register import touch

    (folder / "before.json").write_bytes(rig)
    lines = [[*one["rig_mm"], *one["numbers"]] for one in document["samples"]]
    (folder / "points.csv").write_text("\n".join(",".join(map(repr, line)) for line in lines))
    out = folder / "by_command.json"
    assert 0 == touch(folder / "before.json", folder / "points.csv", out, 0.5, False, Console(quiet=True))
    assert load_rig(out).robot_from_rig is not None
    assert found.tolist() == json.loads(out.read_text())["robot_from_rig"]


@pytest.mark.long
async def test_poses_tell_whose_they_are_which_one_is_wrong_and_which_turn_they_lack(tmp_path: Path) -> None:
    """Poses entered for the wrong brand are recognised; read rightly, a mistyped one is named and ignored,
    and the rig is right, also if the robot carries it."""
    async with on_stage(tmp_path) as newcomer:
        person = Registrar(newcomer, {"mount": "fixed", "kind": "poses", "brand": "kuka"}, "ur")
        await person.begin()
        assert (BOARD, ["X", "Y", "Z", "A", "B", "C"]) == (
            person.document["board"],
            person.document["labels"],
        )
        for _ in range(3):
            await person.pose()
        assert "too_few" == (await person.judged())["trouble"]["code"]
        await person.pose()
        document = await person.judged()
        assert "other_reading" == document["trouble"]["code"]
        told = {
            name: document["trouble"]["params"][name] for name in ("orientation", "unit", "mount", "brand")
        }
        assert {"orientation": "vector-rad", "unit": "m", "mount": "fixed", "brand": "ur"} == told
        assert (
            document["conventions"]
            == (await person.newcomer.ask("GET", f"{person.place}/conventions"))["conventions"]
        )
        await person.do("PUT", "", {"brand": "ur"})
        assert (await person.judged())["trouble"] is None

        for _ in range(2):
            await person.pose()
        mistyped = person.document["samples"][5]
        x, *others = mistyped["numbers"]
        await person.do("PUT", "/samples/pose_006", {"numbers": [x + 0.01, *others]})
        document = await person.judged()
        row = document["samples"][5]
        assert ("pose_006", "outlier", True) == (document["culprit"], row["why"], document["good"])
        assert row["held_out_mm"] > 5
        await person.do("POST", "/solve")
        await newcomer.ask("POST", f"{person.place}/activate", {**newcomer.token, "note": "ten poses"})
        rig = load_rig(tmp_path / "rig.json")
        assert rig.robot_from_rig is not None and small_rig().robot_from_rig is not None
        assert worst_um(rig.robot_from_rig, small_rig().robot_from_rig) < 60

        carried = Registrar(newcomer, {"mount": "flange", "kind": "poses", "brand": "abb"}, "abb", 0)
        await carried.begin()
        for _ in range(4):
            await carried.pose("cameras")
        document = await carried.judged()
        assert (None, True) == (document["trouble"], document["good"])
        document = await carried.do("POST", "/solve")
        assert 9 == len(document["places"])
        for place in document["places"][::4]:
            x, y = place["left"]
            true = (await carried.shown(carries="cameras", x=x, y=y))["numbers"]
            assert np.abs(np.array(true) - place["robot"]["numbers"]).max() < 0.1
        await newcomer.ask("POST", f"{carried.place}/activate", {**newcomer.token, "note": "carried"})
        rig = load_rig(tmp_path / "rig.json")
        assert rig.robot_from_rig is None and rig.flange_from_rig is not None
        assert worst_um(rig.flange_from_rig, FLANGE_FROM_RIG) < 60
