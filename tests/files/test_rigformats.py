"""Rigs in other software's files: the same geometry after writing and reading, checked by other programs
if possible."""

from __future__ import annotations

import io
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from helpers.rigs import make_rig, random_points, rigs
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console
from scipy.spatial.transform import Rotation

from edged.commands.rig import convert
from edged.domain.arrays import FloatArray
from edged.errors import FileFormatError, UserError
from edged.files.rig import load_rig, save_rig
from edged.files.rigformats import Options, RigFormat, read_rig, rig_format, write_rig
from edged.files.rigformats.files import parse_size
from edged.files.rigformats.halcon import gba_angles
from edged.files.rigformats.lens import MAX_ERROR_PX
from edged.vision.geometry.camera import CameraModel, StereoRig
from edged.vision.geometry.rigid import apply

NAMES: dict[RigFormat, str] = {
    "edged": "rig.json",
    "opencv": "rig.yml",
    "ros": "ros",
    "kalibr": "camchain.yaml",
    "halcon": "halcon",
}
BROWN = make_rig("brown")
DIVISION = make_rig("division")


def seen(rig: StereoRig, points: FloatArray) -> FloatArray:
    """(N, 4) pixels in both cameras."""
    right = rig.right.project(apply(rig.right_from_left, points))
    return np.concatenate([rig.left.project(points), right], axis=1)


# --- there and back -----------------------------------------------------------------------------


@pytest.mark.parametrize("form", NAMES)
@pytest.mark.parametrize("rig", [BROWN, DIVISION], ids=["brown", "division"])
def test_a_rig_survives_the_journey(rig: StereoRig, form: RigFormat, tmp_path: Path) -> None:
    """After writing and reading, every point is seen at its place, up to the error that the notes state."""
    notes = write_rig(tmp_path / NAMES[form], rig, form)
    back = read_rig(tmp_path / NAMES[form])
    points = random_points(rig, 200, seed=1)
    # once when written and once when read
    allowed = 2 * MAX_ERROR_PX if any("fitted" in note for note in notes) else 1e-7
    assert np.abs(seen(back.rig, points) - seen(rig, points)).max() < allowed
    np.testing.assert_allclose(back.rig.right_from_left, rig.right_from_left, atol=1e-9)
    assert (back.rig.left.width, back.rig.right.height) == (rig.left.width, rig.right.height)
    native = {"edged": {"brown", "division"}, "halcon": {"division"}}.get(form, {"brown"})
    assert any("fitted" in note for note in notes) == (rig.left.model not in native)


@pytest.mark.slow
@settings(max_examples=25)
@given(rig=rigs, form=st.sampled_from(["opencv", "ros", "kalibr", "halcon"]))
def test_any_rig_survives_or_is_refused(
    rig: StereoRig, form: RigFormat, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Strong lenses that a format cannot follow are refused with the error in px; all others read back."""
    path = tmp_path_factory.mktemp("rig") / NAMES[form]
    try:
        write_rig(path, rig, form)
    except FileFormatError as error:
        assert "px only" in str(error)
        return
    try:
        back = read_rig(path).rig
    except FileFormatError as error:
        assert "px only" in str(error)
        return
    points = random_points(rig, 50, seed=2)
    assert np.abs(seen(back, points) - seen(rig, points)).max() < 2 * MAX_ERROR_PX


def test_what_a_format_cannot_hold_is_said(tmp_path: Path) -> None:
    """The notes name covariance and robot_from_rig, which the format cannot hold."""
    rig = replace(BROWN, robot_from_rig=np.eye(4), covariance=np.eye(len(BROWN.parameter_names)))
    (note,) = write_rig(tmp_path / "rig.yml", rig, "opencv")
    assert "covariance and robot_from_rig" in note


# --- OpenCV -------------------------------------------------------------------------------------


def test_opencv_reads_what_is_written(tmp_path: Path) -> None:
    """cv2.FileStorage reads the file, and cv2.projectPoints sees the points where the rig does."""
    path = tmp_path / "rig.yml"
    write_rig(path, BROWN, "opencv")
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    M1, D1, M2, D2, R, T = (storage.getNode(name).mat() for name in ("M1", "D1", "M2", "D2", "R", "T"))
    storage.release()
    points = random_points(BROWN, 50, seed=3)
    left, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), M1, D1)
    right, _ = cv2.projectPoints(points, R, T, M2, D2)
    expected = seen(BROWN, points)
    np.testing.assert_allclose(left.reshape(-1, 2), expected[:, :2], atol=1e-6)
    np.testing.assert_allclose(right.reshape(-1, 2), expected[:, 2:], atol=1e-6)


def write_opencv_pair(folder: Path, rig: StereoRig, scale: float = 1.0) -> None:
    """intrinsics.yml and extrinsics.yml, as OpenCV's stereo sample writes them: without size or unit."""
    folder.mkdir()
    files = {
        "intrinsics.yml": {
            "M1": rig.left.matrix,
            "D1": np.array([rig.left.distortion]),
            "M2": rig.right.matrix,
            "D2": np.array([rig.right.distortion]),
        },
        "extrinsics.yml": {"R": rig.right_from_left[:3, :3], "T": scale * rig.right_from_left[:3, 3:]},
    }
    for name, values in files.items():
        storage = cv2.FileStorage(str(folder / name), cv2.FILE_STORAGE_WRITE)
        for key, value in values.items():
            storage.write(key, value)
        storage.release()


def test_what_opencv_writes_is_read(tmp_path: Path) -> None:
    """The two files of OpenCV's sample, in metres, give the rig with stated size and unit."""
    write_opencv_pair(tmp_path / "cv", BROWN, scale=0.001)
    back = read_rig(tmp_path / "cv", None, Options(size=(1280, 960), unit_mm=1000.0))
    points = random_points(BROWN, 50, seed=4)
    np.testing.assert_allclose(seen(back.rig, points), seen(BROWN, points), atol=1e-6)
    assert "baseline of 110.000 mm" in back.notes[0]


def test_the_older_dialect_of_opencv_is_read(tmp_path: Path) -> None:
    """Files of OpenCV before 5, which start with the invalid %YAML:1.0, are read."""
    write_rig(tmp_path / "new.yml", BROWN, "opencv")
    text = (tmp_path / "new.yml").read_text().replace("%YAML 1.2", "%YAML:1.0")
    (tmp_path / "old.yml").write_text(text)
    assert (
        read_rig(tmp_path / "old.yml").rig.calibration_id == read_rig(tmp_path / "new.yml").rig.calibration_id
    )


def test_a_missing_size_is_asked_for(tmp_path: Path) -> None:
    """A missing image size is refused with the option that states it."""
    write_opencv_pair(tmp_path / "cv", BROWN)
    with pytest.raises(FileFormatError, match="--size WIDTHxHEIGHT"):
        read_rig(tmp_path / "cv")


# --- ROS ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("vergence_deg", [0.0, 24.0])
def test_ros_rectifies_to_common_rows(vergence_deg: float, tmp_path: Path) -> None:
    """image_proc's mapping with R and P puts each point on one row, disparity f B / Z, in metres."""
    rig = make_rig("brown", vergence_deg)
    write_rig(tmp_path / "ros", rig, "ros")
    points = random_points(rig, 50, seed=5)
    pixels = seen(rig, points)
    rectified, projections = [], []
    for side, raw in (("left", pixels[:, :2]), ("right", pixels[:, 2:])):
        document = yaml.safe_load((tmp_path / "ros" / f"{side}.yaml").read_text())
        K, D, R, P = (
            np.array(document[name]["data"])
            for name in (
                "camera_matrix",
                "distortion_coefficients",
                "rectification_matrix",
                "projection_matrix",
            )
        )
        P = P.reshape(3, 4)
        found = cv2.undistortPoints(raw.reshape(-1, 1, 2), K.reshape(3, 3), D, R=R.reshape(3, 3), P=P[:, :3])
        rectified.append(found.reshape(-1, 2))
        projections.append(P)
    np.testing.assert_allclose(rectified[0][:, 1], rectified[1][:, 1], atol=1e-4)
    parallax = (rectified[0] - rectified[1])[:, 0] - projections[0][0, 2] + projections[1][0, 2]
    document = yaml.safe_load((tmp_path / "ros" / "left.yaml").read_text())
    turn = np.array(document["rectification_matrix"]["data"]).reshape(3, 3)
    depth_m = (points @ turn.T)[:, 2] / 1000
    np.testing.assert_allclose(-projections[1][0, 3] / parallax, depth_m, rtol=1e-6)


# --- HALCON -------------------------------------------------------------------------------------

# the example of read_cam_par's reference page
CAM_PAR = """# INTERNAL CAMERA PARAMETERS

ParGroup: Camera: Parameter;
"Internal camera parameters";

Focus:foc: 0.00806039;
DOUBLE:0.0:;
"Focal length of the lens [meter]";

Kappa:kappa: -2253.5;
DOUBLE::;
"Radial distortion coefficient [1/(meter*meter)]";

Sx:sx: 1.0629e-05;
DOUBLE:0.0:;
"Width of a cell on the sensor [meter]";

Sy:sy: 1.1e-05;
DOUBLE:0.0:;
"Height of a cell on the sensor [meter]";

Cx:cx: 378.236;
DOUBLE:0.0:;
"X-coordinate of the image center [pixel]";

Cy:cy: 297.587;
DOUBLE:0.0:;
"Y-coordinate of the image center [pixel]";

ImageWidth:imgw: 768;
INT:1:32767;
"Width of the images [pixel]";

ImageHeight:imgh: 576;
INT:1:32767;
"Height of the images [pixel]";
"""
POSE = "# Used representation type:\nf {kind}\n\nr {r[0]} {r[1]} {r[2]}\n\nt 0.1097 0.0005 0.0003\n"
POLYNOMIAL = "\n".join(
    f"Poly{n}:poly{n}: {value};\nDOUBLE::;\n" for n, value in enumerate((1500.0, -2e6, 1e10, 0.02, -0.03), 1)
)


def halcon_folder(
    path: Path, camera: str = CAM_PAR, kind: int = 0, angles: tuple[float, ...] = (2.0, 336.4, 358.8)
) -> Path:
    """A folder as a HALCON script writes it."""
    path.mkdir()
    (path / "campar1.dat").write_text(camera)
    (path / "campar2.dat").write_text(camera)
    (path / "relpose.dat").write_text(POSE.format(kind=kind, r=angles))
    return path


def halcon_pixel(point_m: FloatArray) -> tuple[float, float]:
    """The projection of the reference manual, in metres, with the example's parameters."""
    focus, kappa = 0.00806039, -2253.5
    u, v = focus * point_m[0] / point_m[2], focus * point_m[1] / point_m[2]
    shrink = 2 / (1 + math.sqrt(1 - 4 * kappa * (u * u + v * v)))
    return shrink * u / 1.0629e-05 + 378.236, shrink * v / 1.1e-05 + 297.587


def test_halcon_cameras_see_what_the_manual_says(tmp_path: Path) -> None:
    """Focus, kappa in 1/m² and pixel sizes of the manual's example project by the manual's formula."""
    rig = read_rig(halcon_folder(tmp_path / "h")).rig
    for point_m in ([0.05, 0.03, 0.4], [-0.1, 0.08, 0.35]):
        found = rig.left.project(1000 * np.array(point_m))
        np.testing.assert_allclose(found, halcon_pixel(np.array(point_m)), atol=1e-9)
    assert rig.left.model == "division"


def test_halcon_polynomial_undistorts_as_the_manual_says(tmp_path: Path) -> None:
    """K1..P2 in powers of 1/m map distorted to undistorted metric coordinates; the fit follows to 0.05 px."""
    text = CAM_PAR.replace("Kappa:kappa: -2253.5;\nDOUBLE::;\n", POLYNOMIAL)
    imported = read_rig(halcon_folder(tmp_path / "h", camera=text))
    camera, focus = imported.rig.left, 0.00806039
    K1, K2, K3, P1, P2 = 1500.0, -2e6, 1e10, 0.02, -0.03
    for pixel in ([20.0, 30.0], [700.0, 500.0], [378.0, 10.0]):
        u, v = (pixel[0] - camera.cx) * 1.0629e-05, (pixel[1] - camera.cy) * 1.1e-05
        r2 = u * u + v * v
        radial = K1 * r2 + K2 * r2**2 + K3 * r2**3
        ideal = (
            u + u * radial + P1 * (r2 + 2 * u * u) + 2 * P2 * u * v,
            v + v * radial + 2 * P1 * u * v + P2 * (r2 + 2 * v * v),
        )
        found = camera.pixels(np.array(ideal) / focus)
        assert np.linalg.norm(found - pixel) < MAX_ERROR_PX
    assert "brown model fitted" in imported.notes[1]


@pytest.mark.parametrize(
    ("kind", "rotation"),
    [
        (0, Rotation.from_euler("XYZ", (2.0, 336.4, 358.8), degrees=True)),
        (2, Rotation.from_euler("xyz", (2.0, 336.4, 358.8), degrees=True)),
    ],
)
def test_halcon_angles_are_those_of_its_pose_types(kind: int, rotation: Rotation, tmp_path: Path) -> None:
    """gba turns about the moving axes x, y, z; abg about the fixed ones. Camera 2 lies at t, in metres."""
    rig = read_rig(halcon_folder(tmp_path / "h", kind=kind)).rig
    left_from_right = np.linalg.inv(rig.right_from_left)
    np.testing.assert_allclose(left_from_right[:3, :3], rotation.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(left_from_right[:3, 3], (109.7, 0.5, 0.3))


def test_halcon_rodriguez_vectors_have_the_length_tan_of_half_the_angle(tmp_path: Path) -> None:
    """A vector of length tan(12°) along y is a turn by 24°."""
    folder = halcon_folder(tmp_path / "h", kind=4, angles=(0.0, -math.tan(math.radians(12)), 0.0))
    left_from_right = np.linalg.inv(read_rig(folder).rig.right_from_left)
    expected = Rotation.from_euler("y", -24, degrees=True).as_matrix()
    np.testing.assert_allclose(left_from_right[:3, :3], expected, atol=1e-12)


@given(st.tuples(*[st.floats(-180, 180)] * 3))
def test_written_angles_give_the_rotation_back(angles: tuple[float, float, float]) -> None:
    """Written angles give the rotation back, also for y = ±90°."""
    for y in (angles[1], 90.0, -90.0):
        rotation = Rotation.from_euler("XYZ", (angles[0], y, angles[2]), degrees=True).as_matrix()
        found = Rotation.from_euler("XYZ", gba_angles(rotation)).as_matrix()
        np.testing.assert_allclose(found, rotation, atol=1e-9)


@pytest.mark.parametrize("pixel_um", [1.0, 4.65])
def test_the_pixel_size_does_not_matter(pixel_um: float, tmp_path: Path) -> None:
    """Any pixel size gives the same geometry; the true one gives the focal length in metres."""
    write_rig(tmp_path / "h", DIVISION, "halcon", Options(pixel_um=pixel_um))
    assert f"Focus:foc:  {3180 * pixel_um * 1e-6!r}" in (tmp_path / "h" / "cam_left.dat").read_text()
    points = random_points(DIVISION, 20, seed=6)
    np.testing.assert_allclose(seen(read_rig(tmp_path / "h").rig, points), seen(DIVISION, points), atol=1e-8)


# --- Kalibr -------------------------------------------------------------------------------------

# after the format's documentation
CAMCHAIN = """cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 2.1e-4, 1e-5]
  distortion_model: radtan
  intrinsics: [458.6, 457.3, 367.2, 248.4]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.0005]
  - [0.0, 0.0, 1.0, -0.0003]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0, 0]
  distortion_model: radtan
  intrinsics: [457.6, 456.1, 379.9, 255.2]
  resolution: [752, 480]
"""


def test_a_camchain_is_read(tmp_path: Path) -> None:
    """intrinsics, radtan without k3, and T_cn_cnm1 as right_from_left, in metres."""
    (tmp_path / "c.yaml").write_text(CAMCHAIN)
    rig = read_rig(tmp_path / "c.yaml").rig
    assert rig.left == CameraModel(
        "brown", 752, 480, 458.6, 457.3, 367.2, 248.4, (-0.28, 0.07, 2.1e-4, 1e-5, 0.0)
    )
    np.testing.assert_allclose(rig.right_from_left[:3, 3], (-110, 0.5, -0.3))


# --- hostile files ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "radtan\n  intrinsics: [458",
            "equidistant\n  intrinsics: [458",
            "cam0.distortion_model: 'equidistant'",
        ),
        ("pinhole", "omni", "cam0.camera_model: 'omni' is not supported"),
        ("[458.6, 457.3, 367.2, 248.4]", "[458.6, 457.3]", "cam0.intrinsics: expected 4 numbers, got 2"),
        ("458.6", ".nan", "cam0.intrinsics: expected 4 numbers, all finite"),
        ("458.6", "-1.0", "cam0.intrinsics: focal lengths must be positive"),
        ("[752, 480]", "[752, 480.5]", "cam0.height: expected a size"),
        ("[752, 480]", "[752, 1e99]", "cam0.height: expected a size"),
        ("[1.0, 0.0, 0.0, -0.11]", "[1.1, 0.0, 0.0, -0.11]", "cam1.T_cn_cnm1: expected a rotation"),
        ("[1.0, 0.0, 0.0, -0.11]", "[-1.0, 0.0, 0.0, -0.11]", "cam1.T_cn_cnm1: expected a rotation"),
        ("-0.28, 0.07, 2.1e-4", "what", "cam0.distortion_coeffs: expected 4 numbers"),
        ("[-0.28, 0.07, 2.1e-4, 1e-5]", "5", "cam0.distortion_coeffs: expected 4 numbers, got 1"),
        ("  T_cn_cnm1:", "  T_other:", "cam1.T_cn_cnm1: expected 16 numbers, got nothing"),
        ("cam1:\n", "cam1: 5\nrest:\n", "cam1: expected a mapping, got int"),
        ("cam1:\n", "cam2: 0\ncam1:\n", "more than two cameras"),
    ],
)
def test_a_flawed_camchain_is_named_at_its_flaw(old: str, new: str, expected: str, tmp_path: Path) -> None:
    """Each error names the file, the field and what was expected."""
    path = tmp_path / "c.yaml"
    assert old in CAMCHAIN
    path.write_text(CAMCHAIN.replace(old, new, 1))
    with pytest.raises(FileFormatError, match=r"c\.yaml") as caught:
        read_rig(path, "kalibr")
    assert expected in str(caught.value)


def test_cameras_in_one_place_are_refused(tmp_path: Path) -> None:
    """A rig with a baseline of zero is refused."""
    text = CAMCHAIN.replace("-0.11", "0").replace("0.0005", "0").replace("-0.0003", "0")
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(FileFormatError, match="baseline is zero"):
        read_rig(tmp_path / "c.yaml")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("0.00806039", "0", "Focus"),
        ("0.00806039", "eight", "Focus: expected 1 numbers"),
        ("Kappa:kappa", "Other:other", "Kappa"),
        ("768", "0", "ImageWidth: expected a size"),
        ("Focus:foc", 'CameraType:ct: "area_scan_telecentric_division";\nFocus:foc', "CameraType"),
    ],
)
def test_a_flawed_halcon_camera_is_named_at_its_flaw(
    old: str, new: str, expected: str, tmp_path: Path
) -> None:
    """Telecentric cameras, missing and impossible values are refused, each with its message."""
    assert old in CAM_PAR
    folder = halcon_folder(tmp_path / "h", camera=CAM_PAR.replace(old, new, 1))
    with pytest.raises(FileFormatError, match=expected):
        read_rig(folder, "halcon")


def test_halcon_pose_types_of_other_orders_are_refused(tmp_path: Path) -> None:
    """Pose types with another order are refused."""
    with pytest.raises(FileFormatError, match="pose type 8"):
        read_rig(halcon_folder(tmp_path / "h", kind=8))


def test_incomplete_folders_are_refused(tmp_path: Path) -> None:
    """A folder with too few or no camera files is refused with the numbers found."""
    folder = halcon_folder(tmp_path / "h")
    (folder / "campar2.dat").unlink()
    with pytest.raises(FileFormatError, match="found 1 and 1"):
        read_rig(folder)
    write_rig(tmp_path / "ros", BROWN, "ros")
    (tmp_path / "ros" / "left.yaml").unlink()
    with pytest.raises(FileFormatError, match="found 1"):
        read_rig(tmp_path / "ros")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileFormatError, match="not a rig"):
        read_rig(tmp_path / "empty")


@pytest.mark.slow
@settings(max_examples=150)
@given(
    data=st.one_of(st.binary(max_size=300), st.text(max_size=300).map(str.encode)),
    form=st.sampled_from(list(NAMES)),
)
def test_any_bytes_are_a_file_error(
    data: bytes, form: RigFormat, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Any bytes give a FileFormatError."""
    path = tmp_path_factory.mktemp("any") / NAMES[form]
    path.write_bytes(data) if path.suffix else path.mkdir()
    if not path.suffix:
        for name in ("left.yaml", "right.yaml", "a.dat", "b.dat", "c.dat"):
            (path / name).write_bytes(data)
    for stated in (form, None):
        with pytest.raises(FileFormatError):
            read_rig(path, stated)


@pytest.mark.slow
@pytest.mark.parametrize(
    "text",
    [
        "[" * 5000,
        "a: &a [1,2]\nb: *a\nM1: *c\n",
        "M1: !!python/object/apply:os.system [ls]\n",
        "M1: !!opencv-matrix 5\n",
        "? [1, 2]\n: 3\n",
        "\0",
        "M1: {rows: 3, cols: 3, data: {a: 1}}\nimage_width: 5\nimage_height: 5\n",
    ],
)
def test_hostile_yaml_is_a_file_error(text: str, tmp_path: Path) -> None:
    """Deep nesting, object tags, unknown anchors and odd keys are refused with the file's name."""
    path = tmp_path / "x.yml"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=r"x\.yml"):
        read_rig(path, "opencv", Options(size=(10, 10)))


def test_a_huge_file_is_not_parsed(tmp_path: Path) -> None:
    """A file that is much too large is refused without parsing."""
    (tmp_path / "x.yml").write_bytes(b"a: 1\n" * 300_000)
    with pytest.raises(FileFormatError, match="too many"):
        read_rig(tmp_path / "x.yml", "opencv")


# --- the command --------------------------------------------------------------------------------


def test_the_command_converts_and_keeps_what_was_there(tmp_path: Path) -> None:
    """The command converts OpenCV's files to edged, and keeps the former rig under its own id."""
    write_opencv_pair(tmp_path / "cv", BROWN)
    save_rig(tmp_path / "rig.json", DIVISION)
    said = io.StringIO()
    console = Console(file=said, width=200)
    assert (
        convert(tmp_path / "cv", tmp_path / "rig.json", "edged", None, "1280x960", "mm", 3.45, console) == 0
    )
    assert load_rig(tmp_path / "rig.json").baseline_mm == pytest.approx(110)
    assert load_rig(tmp_path / "rig.test.json").left.model == "division"
    assert "do not say their unit" in said.getvalue()
    assert "rig.test.json" in said.getvalue()


@pytest.mark.parametrize(
    ("to", "unit", "size", "target", "expected"),
    [
        ("matlab", "mm", None, "x.json", "expected one of edged, opencv, ros, kalibr, halcon"),
        ("edged", "inch", None, "x.json", "--unit 'inch'"),
        ("edged", "mm", "big", "x.json", "image size 'big'"),
        ("edged", "mm", None, "nowhere/x.json", "there is no folder"),
        ("opencv", "mm", None, "x.json", "expected a file NAME.yml"),
        ("kalibr", "mm", None, "x.json", "expected a file NAME.yaml"),
        ("ros", "mm", None, "rig.json", "expected a folder"),
    ],
)
def test_wrong_usage_is_named(
    to: str, unit: str, size: str | None, target: str, expected: str, tmp_path: Path
) -> None:
    """Wrong usage is refused before anything is written."""
    save_rig(tmp_path / "rig.json", BROWN)
    with pytest.raises(UserError, match=expected.replace("(", r"\(")):
        convert(
            tmp_path / "rig.json", tmp_path / target, to, None, size, unit, 3.45, Console(file=io.StringIO())
        )
    assert [path.name for path in tmp_path.iterdir()] == ["rig.json"]


def test_names_and_sizes_are_parsed() -> None:
    """Formats and sizes are parsed from the command line."""
    assert rig_format("ros") == "ros"
    assert parse_size("1280X960") == (1280, 960)
    with pytest.raises(UserError, match=r"0\.1 to 100"):
        Options(pixel_um=0)
