"""Camera response, blur, asymmetry of the blur and light falloff, from pictures of a chessboard.

The corner between four squares keeps its position whatever the camera's response to light. The edges between
two squares do not: with a nonlinear response (a gamma), an edge blurred by the lens appears displaced towards
the dark side, and its profile is no longer symmetric. The line through two corners gives the true position of
the edge. So the exponent that puts the edges on their lines is the camera's response, provided that the shape
of the profile confirms it; otherwise the cause may just as well be the board's print.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from edged.domain.arrays import B8, I64, SIDES, FloatArray, Image
from edged.vision.boards.board import Board, Charuco, Chessboard, Detection
from edged.vision.boards.deformation import nominal
from edged.vision.boards.params import DETECTION
from edged.vision.calibration.params import IMAGING
from edged.vision.geometry.camera import StereoRig, calibration_identity
from edged.vision.geometry.rectification import linear_grey

MIN_LENGTH_PX = 3.5 * IMAGING.reach_px
"""Shortest usable edge: the patch around its middle, two reaches long, must stay clear of its corners."""


@dataclass(frozen=True, slots=True, eq=False)
class BoardEdges:
    """Square pixel patches (M, P) around the middles of M edges of a board.

    across (M, P) : distance from the line through the edge's corners, px, positive on the bright side.
    grey (M, P); used (M, P) bool.  toward (M, 2) : unit normals, from dark to bright.  middle (M, 2) px.
    dark, bright (M,) grey values beside the edge.  view (M,) : number of the picture.
    """

    across: FloatArray
    grey: FloatArray
    used: B8
    toward: FloatArray
    middle: FloatArray
    dark: FloatArray
    bright: FloatArray
    view: I64

    def some(self, chosen: B8) -> BoardEdges:
        """The edges selected by a mask (M,)."""
        return BoardEdges(*(getattr(self, name)[chosen] for name in self.__slots__))


@dataclass(frozen=True, slots=True)
class Imaging:
    """How one camera images an edge; NaN where the pictures do not determine a value.

    gamma : grey value ~ light ** gamma; 1 unless displacement and profiles of the edges agree on another.
    shift_px, sigma_shift_px : displacement of edges towards the dark side in the pictures as they are.
    blur_px : sigma of the edge spread; also least and largest of nine places.
    asymmetry_px : difference of the spread between the two sides of an edge in the picture, whichever of them
    is dark; largest of the places.
    saturated : share of edges whose bright side is clipped.  falloff : share of the light missing at the
    darkest place, relative to the brightest.  halo : overshoot beside an edge as a share of its step; caused
    by sharpening, never by a lens.
    """

    gamma: float
    shift_px: float
    sigma_shift_px: float
    blur_px: float
    least_blur_px: float
    largest_blur_px: float
    asymmetry_px: float
    saturated: float
    falloff: float
    halo: float = math.nan


UNKNOWN = Imaging(1.0, *[math.nan] * 8)  # a linear response is assumed


def edges_of(image: Image, board: Board, detection: Detection, view: int = 0) -> BoardEdges | None:
    """Edges between neighbouring corners of a chessboard or ChArUco board; None if there are none.

    image (H, W) uint8.  view : number stored with the edges.
    """
    lines = _lines(board, detection)
    if not len(lines):
        return None
    along = lines[:, 1] - lines[:, 0]
    length = np.linalg.norm(along, axis=1)
    middle = lines.mean(axis=1)
    margin = IMAGING.reach_px + 2
    inside = (middle >= margin).all(axis=1) & (middle < np.array(image.shape[::-1]) - margin - 1).all(axis=1)
    fits = inside & (length > MIN_LENGTH_PX)
    if not fits.any():
        return None
    middle, along = middle[fits], along[fits] / length[fits, None]
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    window = np.arange(-IMAGING.reach_px - 1, IMAGING.reach_px + 2)
    x, y = (side.ravel() for side in np.meshgrid(window, window))
    base = np.rint(middle).astype(np.int64)
    column, row = base[:, :1] + x, base[:, 1:] + y
    dx, dy = column - middle[:, :1], row - middle[:, 1:]
    across = dx * normal[:, :1] + dy * normal[:, 1:]
    beside = dx * along[:, :1] + dy * along[:, 1:]
    grey = image[row, column].astype(np.float64)
    used = (np.abs(across) <= IMAGING.reach_px) & (np.abs(beside) <= IMAGING.reach_px)
    low, high = _levels(across, grey, used)
    flip = np.where(high < low, -1.0, 1.0)[:, None]
    return BoardEdges(
        across * flip,
        grey,
        used,
        normal * flip,
        middle,
        np.minimum(low, high),
        np.maximum(low, high),
        np.full(len(middle), view),
    )


def imaging_of(pictures: Sequence[BoardEdges], size: tuple[int, int]) -> Imaging:
    """Imaging properties of one camera from the edges in all of its pictures.

    size (w, h) of the images.
    """
    if not pictures:
        return UNKNOWN
    edges = BoardEdges(
        *(np.concatenate([getattr(picture, name) for picture in pictures]) for name in BoardEdges.__slots__)
    )
    step = edges.bright - edges.dark
    clipped = edges.bright >= DETECTION.white
    saturated = (
        float(np.mean(clipped[step > IMAGING.min_step])) if (step > IMAGING.min_step).any() else math.nan
    )
    good = edges.some(~clipped & (edges.dark > DETECTION.black) & (step > IMAGING.min_step))
    if len(good.view) < IMAGING.min_edges:
        return replace(UNKNOWN, saturated=saturated)
    gamma, shift, sigma = _response(good)
    linear = replace(good, grey=linear_grey(good.grey, gamma))
    whole = _profile(linear)
    blurs, asymmetries, light = [], [], []
    place = np.minimum(good.middle * IMAGING.places / np.array(size), IMAGING.places - 1).astype(np.int64)
    for y in range(IMAGING.places):
        for x in range(IMAGING.places):
            here = (place == (x, y)).all(axis=1)
            if here.sum() < IMAGING.min_edges:
                continue
            there = linear.some(here)
            profile = _profile(there)
            blurs.append(profile.blur_px)
            asymmetries.append(_asymmetry_px(there))
            light.append(float(np.median(linear_grey(good.bright[here], gamma))))
    return Imaging(
        gamma,
        shift,
        sigma,
        whole.blur_px,
        min(blurs, default=math.nan),
        max(blurs, default=math.nan),
        max((value for value in asymmetries if math.isfinite(value)), default=math.nan),
        saturated,
        1.0 - min(light) / max(light) if light else math.nan,
        _halo(_profile(good)),
    )


def with_response(rig: StereoRig, imaging: tuple[Imaging, Imaging]) -> StereoRig:
    """The rig with the cameras' gammas, by which images are linearised before they are measured."""
    left, right = (
        replace(camera, gamma=measured.gamma)
        for camera, measured in zip((rig.left, rig.right), imaging, strict=True)
    )
    identity = calibration_identity(left, right, rig.right_from_left)
    return replace(rig, left=left, right=right, calibration_id=identity)


@dataclass(frozen=True, slots=True)
class ImagingFinding:
    """One finding about the cameras.

    cost_um : effect on a measurement.  remedy : what to do, "" if all is well.
    """

    name: str
    text: str
    cost_um: float
    remedy: str


def findings(imaging: tuple[Imaging, Imaging], rig: StereoRig, depth_mm: float) -> tuple[ImagingFinding, ...]:
    """Findings on response, blur, asymmetry, focus and light of both cameras, with their cost at a depth."""
    focal = 0.25 * (rig.left.fx + rig.left.fy + rig.right.fx + rig.right.fy)
    across_um = 1e3 * depth_mm / focal
    depth_um = across_um * depth_mm / rig.baseline_mm
    found: list[ImagingFinding] = []

    def add(name: str, text: str, cost_um: float, remedy: str, telling: bool) -> None:
        if math.isfinite(cost_um):
            cost = f"{text}: {cost_um:.1f} µm" + (f"; {remedy}" if telling else "")
            found.append(ImagingFinding(name, cost, cost_um, remedy if telling else ""))

    for side, camera in zip(SIDES, imaging, strict=True):
        if camera.gamma != 1.0:
            add(
                f"{side} response",
                f"{side} camera, gamma {camera.gamma:.2f} instead of 1; left in the images, it costs radii",
                abs(camera.shift_px) * across_um,
                "the calibration takes it out; better set the camera's Gamma to 1 and calibrate again",
                telling=True,
            )
        else:
            add(
                f"{side} response",
                f"{side} camera, edges {camera.shift_px:+.3f} px off the lines through their corners; "
                "in a radius this is",
                abs(camera.shift_px) * across_um,
                "it is the camera's response, its sharpening, or ink that has spread",
                telling=abs(camera.shift_px)
                > max(IMAGING.min_shift_px, IMAGING.sure * camera.sigma_shift_px),
            )
        add(
            f"{side} blur",
            f"{side} camera, blur {camera.blur_px:.2f} px, {camera.least_blur_px:.2f} to "
            f"{camera.largest_blur_px:.2f} over the image; at chamfers this may cost in depth",
            math.sqrt(max(camera.largest_blur_px**2 - camera.least_blur_px**2, 0.0)) * depth_um,
            "focus again, or close the aperture",
            telling=camera.largest_blur_px > max(IMAGING.soft_px, 1.5 * camera.least_blur_px),
        )
        add(
            f"{side} asymmetry",
            f"{side} camera, asymmetry of the blur {camera.asymmetry_px:.3f} px; in depth",
            camera.asymmetry_px * depth_um,
            "close the aperture, or check that lens and filter are seated and clean",
            telling=camera.asymmetry_px > IMAGING.max_asymmetry_px,
        )
        add(
            f"{side} sharpening",
            f"{side} camera, halos of {100 * camera.halo:.0f} % beside edges; an edge may be found "
            "displaced by as much of a pixel",
            camera.halo * across_um,
            "the camera sharpens: switch it off",
            telling=camera.halo > IMAGING.max_halo,
        )
        add(
            f"{side} saturation",
            f"{side} camera, {100 * camera.saturated:.0f} % of the edges saturated; in a radius",
            (0.5 * camera.blur_px if math.isfinite(camera.blur_px) else 0.5) * camera.saturated * across_um,
            "less exposure or light",
            telling=camera.saturated > IMAGING.max_saturated,
        )
        add(
            f"{side} falloff",
            f"{side} camera, {100 * camera.falloff:.0f} % of the light missing in the darkest corner; "
            "by its noise, in depth",
            IMAGING.noise_px * (1 / math.sqrt(max(1 - camera.falloff, 0.01)) - 1) * depth_um,
            "open the aperture, or light more evenly",
            telling=camera.falloff > IMAGING.max_falloff,
        )
    left, right = imaging
    unequal = math.sqrt(abs(left.blur_px**2 - right.blur_px**2))
    add(
        "unequal focus",
        f"focus of both cameras, {left.blur_px:.2f} and {right.blur_px:.2f} px; at chamfers this may cost "
        "in depth",
        unequal * depth_um,
        "focus both alike",
        telling=unequal > IMAGING.soft_px,
    )
    return tuple(found)


def _lines(board: Board, detection: Detection) -> FloatArray:
    """Both ends (M, 2, 2) px of every edge between neighbouring corners; none for boards of dots."""
    stated = nominal(board)
    if not isinstance(stated, Chessboard | Charuco):
        return np.zeros((0, 2, 2))
    cells = np.rint(stated.points_mm[detection.ids, :2] / stated.pitch_mm).astype(np.int64)
    known = {(x, y): n for n, (x, y) in enumerate(cells.tolist())}
    pairs = [
        (n, known[beside])
        for (x, y), n in known.items()
        for beside in ((x + 1, y), (x, y + 1))
        if beside in known
    ]
    return detection.pixels[np.array(pairs, np.int64).reshape(-1, 2)]


def _levels(across: FloatArray, grey: FloatArray, used: B8) -> tuple[FloatArray, FloatArray]:
    """Median grey values (M,) of both sides of each edge."""
    sides = (used & (across < -IMAGING.flat_px), used & (across > IMAGING.flat_px))
    low, high = (np.nanmedian(np.where(side, grey, np.nan), axis=1) for side in sides)
    return low, high


# --- profiles --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Profile:
    """Edge profile: share (B,) of the step at place_px (B,); centre_px : where it is 0.5; blur_px : sigma."""

    place_px: FloatArray
    share: FloatArray
    centre_px: float
    blur_px: float

    def at(self, place_px: FloatArray) -> FloatArray:
        """Share at positions relative to the centre."""
        return np.interp(self.centre_px + place_px, self.place_px, self.share)


def _profile(edges: BoardEdges) -> _Profile:
    """Mean profile of edges across their lines, from the grey values as given."""
    low, high = _levels(edges.across, edges.grey, edges.used)
    share = (edges.grey - low[:, None]) / np.maximum(high - low, 1e-9)[:, None]
    bins = int(2 * IMAGING.reach_px / IMAGING.bin_px)
    where = np.clip(
        ((edges.across[edges.used] + IMAGING.reach_px) / IMAGING.bin_px).astype(np.int64), 0, bins - 1
    )
    count = np.bincount(where, minlength=bins)
    total = np.bincount(where, share[edges.used], minlength=bins)
    place = np.linspace(
        0.5 * IMAGING.bin_px - IMAGING.reach_px, IMAGING.reach_px - 0.5 * IMAGING.bin_px, bins
    )
    known = count > 0
    place, mean = place[known], np.asarray(total[known] / count[known], np.float64)
    after = max(int(np.argmax(mean > 0.5)), 1)
    before = after - 1
    within = (0.5 - mean[before]) / max(mean[after] - mean[before], 1e-9)
    centre = float(place[before] + within * (place[after] - place[before]))
    profile = _Profile(place, mean, centre, 0.0)
    tails = np.maximum(1.0 - profile.at(_HALF) + profile.at(-_HALF), 0.0)
    return replace(profile, blur_px=math.sqrt(2.0 * float(np.sum(_HALF * tails)) * IMAGING.bin_px))


_HALF = np.arange(IMAGING.bin_px / 2, IMAGING.reach_px - 2.0, IMAGING.bin_px)
"""Bin centres of half a profile, ending 2 px short: the profile's centre may be off by that much."""


def _halo(profile: _Profile) -> float:
    """Overshoot or undershoot of the profile, whichever is larger, as a share of the step."""
    beside = np.convolve(profile.share, np.full(IMAGING.halo_bins, 1 / IMAGING.halo_bins), "valid")
    return max(float(beside.max()) - 1.0, -float(beside.min()), 0.0)


def _by_sector(edges: BoardEdges) -> list[BoardEdges]:
    """Edges grouped by direction from dark to bright, leaving out directions with too few."""
    return [sector for sector in _sectors(edges) if len(sector.view) >= IMAGING.min_edges]


def _sectors(edges: BoardEdges) -> list[BoardEdges]:
    """Edges of each direction; opposite directions are IMAGING.sectors / 2 apart."""
    angle = np.arctan2(edges.toward[:, 1], edges.toward[:, 0])
    sector = ((angle + math.pi) * IMAGING.sectors / (2 * math.pi)).astype(np.int64) % IMAGING.sectors
    return [edges.some(sector == number) for number in range(IMAGING.sectors)]


def _odd_part(edges: BoardEdges, gamma: float) -> float:
    """Mean square asymmetry of the profiles about their centres, averaged over the directions."""
    squares = []
    for sector in _by_sector(edges) or [edges]:
        profile = _profile(replace(sector, grey=linear_grey(sector.grey, gamma)))
        moved = (
            replace(profile, centre_px=profile.centre_px + step) for step in np.arange(-0.03, 0.031, 0.01)
        )
        squares.append(min(float(np.mean((p.at(_HALF) + p.at(-_HALF) - 1.0) ** 2)) for p in moved))
    return float(np.mean(squares))


def _shift_px(edges: BoardEdges, gamma: float) -> float:
    """Displacement of the edges towards the dark side, averaged over the directions."""
    centres = [
        _profile(replace(sector, grey=linear_grey(sector.grey, gamma))).centre_px
        for sector in _by_sector(edges) or [edges]
    ]
    return -float(np.mean(centres))


def _response(edges: BoardEdges) -> tuple[float, float, float]:
    """Gamma (1 unless certain), displacement of the edges without correction, and its sigma, px."""
    shift = _shift_px(edges, 1.0)
    views = [edges.some(edges.view == number) for number in np.unique(edges.view)]
    parts = views if len(views) > 1 else _by_sector(edges)
    each = [-_profile(part).centre_px for part in parts if len(part.view) >= IMAGING.min_edges]
    sigma = float(np.std(each, ddof=1) / math.sqrt(len(each))) if len(each) > 1 else abs(shift)
    if abs(shift) < max(IMAGING.min_shift_px, IMAGING.sure * sigma):
        return 1.0, shift, sigma
    low, high = np.log(IMAGING.gamma_range)
    for _ in range(14):  # bisection: the displacement grows with the assumed exponent
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _shift_px(edges, math.exp(middle)) > 0 else (middle, high)
    gamma = round(math.exp(0.5 * (low + high)), 3)
    confirmed = _odd_part(edges, gamma) < IMAGING.confirmed * _odd_part(edges, 1.0)
    return (gamma if confirmed else 1.0), shift, sigma


def _asymmetry_px(edges: BoardEdges) -> float:
    """Largest asymmetry of the blur, from the tails of the profiles of opposite directions."""
    skew = []
    for sector in _sectors(edges):
        if len(sector.view) < IMAGING.min_edges // IMAGING.sectors:
            skew.append(math.nan)
            continue
        profile = _profile(sector)
        skew.append(float(np.sum(profile.at(_HALF) + profile.at(-_HALF) - 1.0)) * IMAGING.bin_px)
    pairs = [0.5 * abs(skew[n] - skew[n + IMAGING.sectors // 2]) for n in range(IMAGING.sectors // 2)]
    known = [value for value in pairs if math.isfinite(value)]
    return max(known) if known else math.nan
