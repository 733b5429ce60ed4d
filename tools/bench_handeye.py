#!/usr/bin/env python3
"""Solve hand-eye calibrations of real robots from public pictures, and compare the stated sigma with scatter.

    tools/bench handeye [--pictures DIR [--write]] [--kuka DIR] [--json FILE]

The sets are of robot_cal_tools (github.com/Jmeyer1292/robot_cal_tools, Apache-2.0): a board on an industrial
robot's flange before a fixed camera, and a camera on a flange above a plate of dots. Marks and poses are in
tests/data/hand-eye. With --pictures the marks are measured anew, DIR being rct_examples/data of that
repository; --write stores them in tests/data/hand-eye.

Three more are of I. Ali et al., "Methods for Simultaneous Robot-World-Hand-Eye Calibration: A Comparative
Study", Sensors 19, 2837, 2019 (github.com/ihtishamaliktk/RWHE-Calib): cameras on the flange of a KUKA and a
board that stands still. Their repository states no licence, so nothing of them is stored here: --kuka is its
folder Datasets.

Each has one camera, so the board is placed by its plane alone. The lens is calibrated from the same pictures.
The true places of camera and board are unknown. The figures are: rms and held out, the distance of the marks
of a pose from the fit of all poses, or of all others; jackknife, the sigma of the camera's place implied by
the scatter of the fits that leave out one pose each, beside the stated one. The second row of a set scales
the board to the size by which the poses agree best, with the robot as the ruler.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from benching import TESTS, bench_parser, finish

from edged.domain.arrays import FloatArray, Image
from edged.files.images import load_image
from edged.files.tables import number_of, read_table
from edged.robot.handeye import Mount, hand_eye
from edged.robot.orientations import matrix_quaternion
from edged.vision.boards.board import Charuco, Chessboard, Detection, DotBoard, NotDetected
from edged.vision.boards.circlegrid import remeasure_dots
from edged.vision.boards.detection import detect_board
from edged.vision.geometry.camera import CameraModel
from edged.vision.geometry.rigid import (
    invert,
    quaternion,
    rotation_matrix,
    rotation_vector,
    transform,
)

DATA = TESTS / "data/hand-eye"
GOLDEN = (np.sqrt(5) - 1) / 2


@dataclass(frozen=True, slots=True)
class PublicSet:
    """A set: its folder, its board, the mounting of the camera, the size of its pictures."""

    name: str
    folder: str
    board: Chessboard | Charuco | DotBoard
    mount: Mount
    size: tuple[int, int]


SETS = (
    PublicSet(
        "charuco", "test_set_charuco", Charuco(5, 7, 36.195, 18.256, "6X6_250"), "eye-to-hand", (1600, 1200)
    ),
    PublicSet("dots", "test_set_10x10", DotBoard(10, 10, 25.4, 12.7), "eye-in-hand", (640, 480)),
)
"""Board sizes as in the sets' target.yaml; the diameter of the dots is measured in the pictures."""
KUKA_SETS = (
    PublicSet("kuka 1", "kuka_1", Chessboard(28, 17, 20.0), "eye-in-hand", (1928, 1208)),
    PublicSet("kuka 2", "kuka_2", Chessboard(24, 17, 15.0), "eye-in-hand", (1920, 1200)),
    PublicSet("kuka 3", "kuka_3", Charuco(12, 9, 60.0, 45.0, "5X5_1000"), "eye-in-hand", (1928, 1208)),
)
"""Squares as in their squaresize.txt; their number, and the markers, as seen in the pictures."""


@dataclass(frozen=True, slots=True, eq=False)
class PosedMarks:
    """Marks of one picture, and robot_from_flange."""

    name: str
    ids: FloatArray
    pixels: FloatArray
    robot_from_flange: FloatArray


@dataclass(frozen=True, slots=True)
class HandEyeRow:
    """Figures of one set; lengths mm, angles degrees. outliers : names of the rejected poses.

    size : of the board, relative to the stated one.
    """

    name: str
    size: float
    poses: int
    outliers: tuple[str, ...]
    reprojection_px: float
    rms_mm: float
    held_out_mm: float
    held_out_deg: float
    sigma_mm: tuple[float, ...]
    jackknife_mm: tuple[float, ...]
    sigma_deg: tuple[float, ...]
    jackknife_deg: tuple[float, ...]


def main() -> int:
    """Print the table."""
    parser = bench_parser(__doc__)
    parser.add_argument("--pictures", type=Path, help="rct_examples/data: measure the marks in the pictures")
    parser.add_argument("--write", action="store_true", help="keep what was measured in tests/data/hand-eye")
    parser.add_argument("--kuka", type=Path, help="Datasets of RWHE-Calib: its three sets of a KUKA as well")
    options = parser.parse_args()
    rows = []
    print(
        "| set | size | poses | outliers | marks px | rms mm | held out mm, ° | sigma mm | jackknife mm "
        "| sigma ° | jackknife ° |"
    )
    print("|---|--:|--:|---|--:|--:|--:|--:|--:|--:|--:|")
    for dataset in (*SETS, *(KUKA_SETS if options.kuka else ())):
        if dataset in KUKA_SETS:
            views = seen_views(dataset, kuka_pictures(options.kuka / dataset.folder))
        elif options.pictures is None:
            views = kept_views(dataset)
        else:
            views = measured_views(dataset, options.pictures / dataset.folder)
            if options.write:
                keep(dataset, views)
        for row in rows_of(dataset, views):
            rows.append(row)
            print(
                f"| {row.name} | {row.size:.4f} | {row.poses} | {', '.join(row.outliers) or '-'} "
                f"| {row.reprojection_px:.3f} "
                f"| {row.rms_mm:.2f} | {row.held_out_mm:.2f}, {row.held_out_deg:.3f} "
                f"| {listed(row.sigma_mm)} | {listed(row.jackknife_mm)} "
                f"| {listed(row.sigma_deg, 3)} | {listed(row.jackknife_deg, 3)} |"
            )
    finish(options, rows)
    return 0


def listed(values: tuple[float, ...], digits: int = 2) -> str:
    """Values as text for a cell of the table."""
    return " ".join(f"{value:.{digits}f}" for value in values)


def rows_of(dataset: PublicSet, views: list[PosedMarks]) -> list[HandEyeRow]:
    """Solve a set with the board's stated size, and with the size measured by the robot."""
    placed, reprojection_px = board_poses(dataset, views)
    sizes = (1.0, size_by_robot(dataset, [view.robot_from_flange for view in views], placed))
    return [figures_of(dataset, views, scaled(placed, size), size, reprojection_px) for size in sizes]


def figures_of(
    dataset: PublicSet, views: list[PosedMarks], placed: list[FloatArray], size: float, reprojection_px: float
) -> HandEyeRow:
    """Solve a set, and check its consistency."""
    poses = [view.robot_from_flange for view in views]
    solved = hand_eye(poses, placed, size * dataset.board.points_mm, dataset.mount)
    kept = np.flatnonzero(solved.used)
    left_out = []
    for index in kept:
        others = [other for other in kept if other != index]
        left_out.append(
            hand_eye(
                [poses[other] for other in others],
                [placed[other] for other in others],
                size * dataset.board.points_mm,
                dataset.mount,
                hold_out=False,
            )
        )
    apart = np.array([motion(solved.rig, fit.rig) for fit in left_out])
    spread = (len(kept) - 1) / len(kept) * ((apart - apart.mean(axis=0)) ** 2).sum(axis=0)
    jackknife, sigma = np.sqrt(spread), np.sqrt(np.diag(solved.covariance))
    held = solved.held_out_mm[kept], solved.held_out_rad[kept]
    return HandEyeRow(
        dataset.name,
        size,
        len(views),
        tuple(views[index].name for index in np.flatnonzero(~solved.used)),
        reprojection_px,
        solved.rms_mm,
        float(np.sqrt(np.mean(held[0] ** 2))),
        float(np.degrees(np.sqrt(np.mean(held[1] ** 2)))),
        tuple(sigma[:3].tolist()),
        tuple(jackknife[:3].tolist()),
        tuple(np.degrees(sigma[3:]).tolist()),
        tuple(np.degrees(jackknife[3:]).tolist()),
    )


def size_by_robot(dataset: PublicSet, poses: list[FloatArray], placed: list[FloatArray]) -> float:
    """Board size, relative to the stated one, by which poses agree best; golden section in +-5 %."""

    def rms_mm(size: float) -> float:
        return hand_eye(
            poses, scaled(placed, size), size * dataset.board.points_mm, dataset.mount, hold_out=False
        ).rms_mm

    low, high = 0.95, 1.05
    while high - low > 1e-4:
        first, second = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        low, high = (low, second) if rms_mm(first) < rms_mm(second) else (first, high)
    return (low + high) / 2


def scaled(placed: list[FloatArray], size: float) -> list[FloatArray]:
    """Poses of a board larger by a factor: farther away by that factor."""
    return [transform(pose[:3, :3], size * pose[:3, 3]) for pose in placed]


def motion(pose: FloatArray, other: FloatArray) -> FloatArray:
    """Small motion (shift mm, rotation rad), about the frame's origin, from one pose to another."""
    step = other @ invert(pose)
    return np.concatenate([step[:3, 3], rotation_vector(step[:3, :3])])


def board_poses(dataset: PublicSet, views: list[PosedMarks]) -> tuple[list[FloatArray], float]:
    """camera_from_board of each picture, and the rms of the marks, px; lens and poses in one adjustment."""
    boards = [dataset.board.points_mm[view.ids.astype(int)].astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32).reshape(-1, 1, 2) for view in views]
    rms, _, _, turns, shifts = cv2.calibrateCamera(
        boards, pixels, dataset.size, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3
    )
    placed = [
        transform(rotation_matrix(np.ravel(turn)), np.ravel(shift))
        for turn, shift in zip(turns, shifts, strict=True)
    ]
    return placed, float(rms)


# --- the pictures, and what is kept of them ------------------------------------------------------


def kept_views(dataset: PublicSet) -> list[PosedMarks]:
    """Views of a set stored in tests/data/hand-eye."""
    marks: dict[str, list[list[float]]] = {}
    for line in read_table(DATA / f"{dataset.name}.csv"):
        if line.cells:
            marks.setdefault(line.cells[0], []).append([number_of(cell) for cell in line.cells[1:]])
    views = []
    for line in read_table(DATA / f"{dataset.name}_poses.csv"):
        if line.cells:
            seen = np.array(marks[line.cells[0]])
            pose = posed(*(number_of(cell) for cell in line.cells[1:]))
            views.append(PosedMarks(line.cells[0], seen[:, 0], seen[:, 1:], pose))
    return views


def keep(dataset: PublicSet, views: list[PosedMarks]) -> None:
    """Store measured views in tests/data/hand-eye."""
    poses, marks = ["# x y z mm, quaternion x y z w: robot_from_flange", "view,x,y,z,qx,qy,qz,qw"], []
    for view in views:
        numbers = raw_pose(view.robot_from_flange)
        poses.append(",".join([view.name, *(f"{number:.9g}" for number in numbers)]))
        for mark, (x, y) in zip(view.ids.tolist(), view.pixels.tolist(), strict=True):
            marks.append(f"{view.name},{mark:.0f},{x:.3f},{y:.3f}")
    (DATA / f"{dataset.name}_poses.csv").write_text("\n".join(poses) + "\n")
    header = "# image (x, y) in px of each mark; integer: the middle of a pixel"
    (DATA / f"{dataset.name}.csv").write_text("\n".join([header, "view,mark,x,y", *marks]) + "\n")


def posed(x: float, y: float, z: float, qx: float, qy: float, qz: float, qw: float) -> FloatArray:
    """robot_from_flange (4, 4) from mm and a quaternion."""
    return transform(matrix_quaternion(qw, qx, qy, qz), np.array([x, y, z]))


def raw_pose(pose: FloatArray) -> tuple[float, ...]:
    """mm and the quaternion (x, y, z, w) of a pose."""
    w, x, y, z = quaternion(pose[:3, :3])
    return (*pose[:3, 3].tolist(), float(x), float(y), float(z), float(w))


def measured_views(dataset: PublicSet, folder: Path) -> list[PosedMarks]:
    """Views from the pictures of a set of robot_cal_tools in which the board is found."""
    posed_pictures = []
    for path in sorted((folder / "images").glob("*.png"), key=lambda path: int(path.stem)):
        text = (folder / "poses" / f"{path.stem}.yaml").read_text()
        numbers = dict(re.findall(r"(\w+):\s*(\S+)", text))
        place = [1e3 * float(numbers[axis]) for axis in "xyz"]
        turn = [float(numbers[f"q{axis}"]) for axis in "xyzw"]
        posed_pictures.append((path, posed(*place, *turn)))
    return seen_views(dataset, posed_pictures)


def kuka_pictures(folder: Path) -> list[tuple[Path, FloatArray]]:
    """Pictures, and robot_from_flange of each: a line of 16 numbers in metres."""
    pictures = sorted((*folder.glob("*.png"), *folder.glob("*.bmp")))
    lines = (folder / "RobotPosesVec.txt").read_text().splitlines()
    poses = np.array([line.split() for line in lines], float).reshape(-1, 4, 4)
    poses[:, :3, 3] *= 1e3
    return list(zip(pictures, poses, strict=True))


def seen_views(dataset: PublicSet, posed_pictures: list[tuple[Path, FloatArray]]) -> list[PosedMarks]:
    """Views from the pictures in which the board is found."""
    views = []
    for path, pose in posed_pictures:
        found = detected(dataset, load_image(path))
        if found is None:
            print(f"{dataset.name} {path.name}: the board is not found", file=sys.stderr)
            continue
        views.append(PosedMarks(path.stem, found.ids.astype(float), found.pixels, pose))
    if not views:
        raise SystemExit(f"{dataset.name}: no picture that shows the board")
    return views


def detected(dataset: PublicSet, image: Image) -> Detection | None:
    """Marks of a picture; on the plate, whose first dot is larger, OpenCV determines their order."""
    if not isinstance(dataset.board, DotBoard):
        found = detect_board(image, dataset.board)
        return None if isinstance(found, NotDetected) else found
    columns, rows = dataset.board.columns, dataset.board.rows
    known, centres = cv2.findCirclesGrid(image, (columns, rows), None, flags=cv2.CALIB_CB_SYMMETRIC_GRID)
    if not known:
        return None
    grid = centres.reshape(rows, columns, 2).astype(float)
    corners = [largest_at(image, grid[row, column]) for row, column in ((0, 0), (0, -1), (-1, -1), (-1, 0))]
    grid = np.rot90(grid, int(np.argmax(corners)))
    if np.linalg.det([grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]]) < 0:
        grid = grid.transpose(1, 0, 2)
    ids, pixels = np.arange(columns * rows), grid.reshape(-1, 2)
    height, width = image.shape
    camera = CameraModel("brown", width, height, 550.0, 550.0, width / 2, height / 2, (0.0,) * 5)
    _, turn, shift = cv2.solvePnP(dataset.board.points_mm, pixels, camera.matrix, None)
    seen = Detection(ids, pixels, np.full(len(ids), 0.1), 1.0, 100.0)
    pose = transform(rotation_matrix(np.ravel(turn)), np.ravel(shift))
    found = remeasure_dots(image, dataset.board, seen, camera, pose)
    return None if isinstance(found, NotDetected) else found


def largest_at(image: Image, centre: FloatArray) -> int:
    """Number of connected dark pixels at a place."""
    _, labels, sizes, _ = cv2.connectedComponentsWithStats((image < 128).astype(np.uint8))
    label = int(labels[round(centre[1]), round(centre[0])])
    return int(sizes[label, cv2.CC_STAT_AREA]) if label else 0


if __name__ == "__main__":
    cv2.setNumThreads(1)
    sys.exit(main())
