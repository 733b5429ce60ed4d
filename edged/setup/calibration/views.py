"""Calibrates a rig from pairs that show a board; pairs can be added and removed before solving."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from edged.domain.arrays import SIDES, Image, Side
from edged.errors import CalibrationError
from edged.pictures.encoding import shrunk
from edged.report.calibration import ReportExtras, calibration_report
from edged.setup.calibration.boards import check_board_shown, shows_another, spread
from edged.setup.pairs import Pair, Picture, Progress, silent, work_on
from edged.vision.boards.board import Detection, NominalBoard, NotDetected, StereoView
from edged.vision.boards.deformation import nominal
from edged.vision.boards.detection import detect_board, remeasure_board
from edged.vision.calibration.calibrate import Calibration, ViewFit, calibrate_stereo
from edged.vision.calibration.crossvalidation import HeldOutView, hold_out
from edged.vision.calibration.imaging import (
    BoardEdges,
    Imaging,
    ImagingFinding,
    edges_of,
    findings,
    imaging_of,
    with_response,
)
from edged.vision.calibration.lenschoice import LensWish
from edged.vision.calibration.nextbestview import depths_mm
from edged.vision.calibration.plainopencv import plain_opencv
from edged.vision.calibration.verdict import CalibrationVerdict, judge_calibration
from edged.vision.geometry.camera import StereoRig
from edged.vision.geometry.rectification import make_rectification

FIRST_LOOKED_AT = 3
"""Pairs examined first: the first, the last and between. If none shows the board, it is checked whether they
show another one, before a long search of all the others."""
THUMBNAIL_PX = 240
"""Width of the pictures in the report: a few kB each."""

Sizes = tuple[tuple[int, int], tuple[int, int]]
"""(width, height) of the left and of the right images, px."""


@dataclass(frozen=True, slots=True, eq=False)
class Looked:
    """Detection results of each board in a picture. size (w, h). digest : of the pixels, to detect copies.

    small : thumbnail, THUMBNAIL_PX wide at most.
    """

    size: tuple[int, int]
    digest: bytes
    small: Image
    results: Sequence[Detection | NotDetected]


@dataclass(frozen=True, slots=True, eq=False)
class Remeasured:
    """Views after a second measurement. views : of all pairs; marks of those used were measured again.

    edges : the board's edges in the used ones, by the name of the pair and the side.
    """

    views: list[StereoView]
    edges: Mapping[tuple[str, Side], BoardEdges | None]

    def imaging(self, calibration: Calibration) -> tuple[Imaging, Imaging]:
        """Imaging of the left and of the right camera, from the edges of the boards."""
        left, right = (
            imaging_of(
                [
                    replace(edges, view=np.full(len(edges.view), number))
                    for number, fit in enumerate(calibration.views)
                    if (edges := self.edges[fit.name, side]) is not None
                ],
                (camera.width, camera.height),
            )
            for side, camera in zip(SIDES, (calibration.rig.left, calibration.rig.right), strict=True)
        )
        return left, right


class Views:
    """The pairs of a calibration, in the order they were added, with the boards found in each."""

    def __init__(self, boards: Sequence[NominalBoard]) -> None:
        self.boards = tuple(boards)
        self._pairs: dict[str, tuple[Pair, Looked, Looked]] = {}

    @property
    def pairs(self) -> list[Pair]:
        """All pairs."""
        return [pair for pair, _, _ in self._pairs.values()]

    def add(self, pairs: Sequence[Pair], progress: Progress = silent) -> None:
        """Add pairs, and find one of the boards in each picture.

        A pair replaces an earlier one of the same name. Raises `ImageError`, and `CalibrationError` if the
        first of many pairs that are examined show another board; then none of these pairs is added.
        """
        some = {pair.name: pair for pair in spread(pairs, FIRST_LOOKED_AT)}
        lefts = [pair.left for pair in some.values()]
        is_asked = len(pairs) > len(some) and len(self.boards) == 1
        if (
            is_asked
            and all(shows_another(left, self.boards[0]) for left in lefts)
            # a board that is cut off looks like another one, but may still be found
            and not _shows_any(look_at([*some.values()][:1], self.boards, progress)[0])
        ):
            check_board_shown(lefts, self.boards[0], progress)
        looked = dict(zip(some, look_at([*some.values()], self.boards, progress), strict=True))
        if is_asked and not any(map(_shows_any, looked.values())):
            check_board_shown(lefts, self.boards[0], progress)
        if others := {pair.name: pair for pair in pairs if pair.name not in some}:
            looked |= zip(others, look_at([*others.values()], self.boards, progress), strict=True)
        for pair in pairs:
            self.put(pair, *looked[pair.name])

    def put(self, pair: Pair, left: Looked, right: Looked) -> None:
        """Add a pair whose detection results for these boards are known."""
        self._pairs[pair.name] = pair, left, right

    def remove(self, name: str) -> None:
        """Remove a pair. Raises `KeyError` for an unknown name."""
        del self._pairs[name]

    @property
    def found(self) -> list[StereoView]:
        """One view for each pair; a copy of another pair counts as not detected."""
        views: list[StereoView] = []
        first_with: dict[bytes, str] = {}
        for name, (_, left, right) in self._pairs.items():
            twin = first_with.setdefault(left.digest, name)
            if left.digest == right.digest:
                missed = NotDetected("the left and the right picture are the same file twice")
                views.append(StereoView(name, self.boards[0], missed, missed))
            elif twin != name:
                missed = NotDetected(f"the same picture as in {twin}: it would count twice")
                views.append(StereoView(name, self.boards[0], missed, missed))
            else:
                views.append(_view(name, self.boards, left.results, right.results))
        return views

    @property
    def sizes(self) -> Sizes:
        """Image size of each camera. Raises `CalibrationError` for images of different sizes."""
        left, right = (
            _common_size(
                [pair.side(side).label for pair in self.pairs],
                [looked[index].size for _, *looked in self._pairs.values()],
            )
            for index, side in enumerate(SIDES)
        )
        return left, right

    def check_board(self, progress: Progress = silent) -> None:
        """Check the stated board if few pairs show it. Raises `CalibrationError` if they show another."""
        seen = [not isinstance(view.left, NotDetected) for view in self.found]
        if len(self.boards) > 1 or 2 * sum(seen) > len(seen):
            return
        missed = [pair.left for pair, is_seen in zip(self.pairs, seen, strict=True) if not is_seen]
        check_board_shown(missed, self.boards[0], progress)

    @property
    def thumbnails(self) -> dict[str, tuple[Image, Image]]:
        """Thumbnails of the left and the right picture of each pair."""
        return {name: (left.small, right.small) for name, (_, left, right) in self._pairs.items()}

    def remeasured(self, calibration: Calibration, progress: Progress = silent) -> Remeasured:
        """The views of `found`; marks of those that were used are measured again with the known lenses."""
        rig = calibration.rig
        keys = [(fit, side) for fit in calibration.views for side in SIDES]
        tasks = [
            partial(_remeasure, self._pairs[fit.name][0].side(side), fit, side, rig) for fit, side in keys
        ]
        measured = work_on(tasks, "measuring the marks and edges", progress)
        done = {(fit.name, side): found for (fit, side), found in zip(keys, measured, strict=True)}
        views = [
            replace(view, left=done[view.name, "left"][0], right=done[view.name, "right"][0])
            if (view.name, "left") in done
            else view
            for view in self.found
        ]
        return Remeasured(views, {key: edges for key, (_, edges) in done.items()})


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """A calibration and its quality.

    views : of all pairs, excluded ones too. found : findings on the cameras from the boards' edges.
    quality : figures that the rig file keeps. thumbnails : of all pairs.
    """

    calibration: Calibration
    views: tuple[StereoView, ...]
    held: tuple[HeldOutView, ...]
    found: tuple[ImagingFinding, ...]
    verdict: CalibrationVerdict
    quality: Mapping[str, Any]
    thumbnails: Mapping[str, tuple[Image, Image]]

    @property
    def rig(self) -> StereoRig:
        """The calibrated rig, checked to be rectifiable."""
        return self.calibration.rig


def solve(
    views: Views, lens: LensWish, *, plate_shape: bool = False, progress: Progress = silent
) -> Calibrated:
    """Calibrate from all pairs, and judge the result. Raises `CalibrationError` if they give no rig.

    plate_shape : also measure how the board is bent and misprinted.
    """
    sizes = views.sizes
    views.check_board(progress)
    progress("bundle adjustment", 0, 0)
    first = calibrate_stereo(views.found, *sizes, lens)
    remeasured = views.remeasured(first, progress)
    progress("bundle adjustment", 0, 0)
    calibration = calibrate_stereo(remeasured.views, *sizes, lens, plate_shape=plate_shape)
    progress("holding views out", 0, 0)
    held = hold_out(calibration)
    imaging = remeasured.imaging(calibration)
    found = findings(imaging, calibration.rig, float(depths_mm(calibration)[1]))
    calibration = replace(calibration, rig=with_response(calibration.rig, imaging))
    # A rig that cannot be rectified is useless: find out before it replaces the old one.
    make_rectification(calibration.rig)
    progress("the verdict", 0, 0)
    verdict = judge_calibration(calibration, held, imaging)
    quality = {
        **quality_figures(calibration, held, views.boards),
        "imaging": [asdict(finding) for finding in found],
        "verdict": {"grade": verdict.grade, "why": list(verdict.why), "add": verdict.add},
    }
    return Calibrated(
        calibration, tuple(remeasured.views), tuple(held), tuple(found), verdict, quality, views.thumbnails
    )


def report_of(calibrated: Calibrated, about: Mapping[str, str]) -> str:
    """Report as a page. about : where the pictures come from, and when it was made."""
    calibration = calibrated.calibration
    sizes = [(camera.width, camera.height) for camera in (calibration.rig.left, calibration.rig.right)]
    plain = plain_opencv([fit.view for fit in calibration.views], sizes[0], sizes[1])
    also = ReportExtras(about, plain, calibrated.found, str(calibrated.verdict), calibrated.thumbnails)
    return calibration_report(calibration, calibrated.held, calibrated.views, calibrated.quality, also)


def quality_figures(
    calibration: Calibration, held: Sequence[HeldOutView], boards: Sequence[NominalBoard]
) -> dict[str, Any]:
    """Figures of the calibration's quality that the rig file keeps."""
    return {
        "board": ",".join(str(board) for board in boards),
        "views": len(calibration.views),
        "excluded": [{"view": name, "reason": reason} for name, reason in calibration.excluded],
        "stereo_rms_px": round(calibration.rms_px, 5),
        "left_rms_px": round(calibration.rms_left_px, 5),
        "right_rms_px": round(calibration.rms_right_px, 5),
        "epipolar_rms_px": round(calibration.epipolar_rms_px, 5),
        "held_out": _held_out_figures(held),
        "model_error_px": [round(value, 5) for value in calibration.model_error_px],
        "outliers": calibration.outliers,
        "lenses": {lens.name: round(lens.weight, 4) for lens in calibration.lenses},
        "notes": list(calibration.notes),
    }


def _held_out_figures(held: Sequence[HeldOutView]) -> dict[str, Any] | None:
    """Root mean squares over the held-out views; None if no view could be held out."""
    if not held:
        return None

    def rms(values: Sequence[float]) -> float:
        return round(float(np.sqrt(np.mean(np.square(values)))), 6)

    scales = np.array([view.scale for view in held])
    return {
        "reprojection_rms_px": rms([view.reprojection_rms_px for view in held]),
        "epipolar_rms_px": rms([view.epipolar_rms_px for view in held]),
        "board_size": round(float(scales.mean()), 7),
        "board_size_std": round(float(scales.std()), 7),
        "length_error_rms_mm": rms([view.length_error_mm for view in held]),
        "flatness_rms_mm": rms([view.flatness_mm for view in held]),
    }


def look_at(
    pairs: Sequence[Pair], boards: Sequence[NominalBoard], progress: Progress = silent
) -> list[tuple[Looked, Looked]]:
    """Find the boards in both pictures of each pair. Raises `ImageError`."""
    tasks = [partial(_look, picture, boards) for pair in pairs for picture in (pair.left, pair.right)]
    looked = work_on(tasks, "finding the board", progress)
    return list(zip(looked[::2], looked[1::2], strict=True))


def _shows_any(looked: tuple[Looked, Looked]) -> bool:
    """Whether one of the boards was found in either picture of a pair."""
    return any(isinstance(result, Detection) for picture in looked for result in picture.results)


def _look(picture: Picture, boards: Sequence[NominalBoard]) -> Looked:
    """Look for each board in turn; once one is found, the others are not tried."""
    image = picture.read()
    results: list[Detection | NotDetected] = []
    for board in boards:
        seen_another = any(isinstance(result, Detection) for result in results)
        results.append(NotDetected("shows another board") if seen_another else detect_board(image, board))
    size = image.shape[1], image.shape[0]
    return Looked(size, hashlib.sha256(image.tobytes()).digest(), shrunk(image, THUMBNAIL_PX), results)


def _view(
    name: str,
    boards: Sequence[NominalBoard],
    left: Sequence[Detection | NotDetected],
    right: Sequence[Detection | NotDetected],
) -> StereoView:
    """The view of the board that most pictures show; the first board if none is found."""
    choices = [StereoView(name, *each) for each in zip(boards, left, right, strict=True)]
    return min(
        choices, key=lambda view: isinstance(view.left, NotDetected) + isinstance(view.right, NotDetected)
    )


def _remeasure(
    picture: Picture, fit: ViewFit, side: Side, rig: StereoRig
) -> tuple[Detection | NotDetected, BoardEdges | None]:
    """Measure the marks of a picture again, and the edges between them."""
    board, camera, camera_from_board = nominal(fit.view.board), rig.left, fit.left_from_board
    if side == "right":
        camera, camera_from_board = rig.right, rig.right_from_left @ fit.left_from_board
    image = picture.read()
    marks = remeasure_board(image, board, fit.view.found(side), camera, camera_from_board)
    return marks, None if isinstance(marks, NotDetected) else edges_of(image, board, marks)


def _common_size(labels: Sequence[str], sizes: Sequence[tuple[int, int]]) -> tuple[int, int]:
    if not sizes:
        raise CalibrationError("no pairs")
    usual, _ = Counter(sizes).most_common(1)[0]
    others = [f"  {label}: {w} x {h}" for label, (w, h) in zip(labels, sizes, strict=True) if (w, h) != usual]
    if others:
        raise CalibrationError(
            f"pictures of one camera have different sizes; most are {usual[0]} x {usual[1]}, but\n"
            + "\n".join(others)
        )
    return usual
