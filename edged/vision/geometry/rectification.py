"""Rectification: both views are rotated so that corresponding points lie on one row (paper, 3.2).

The rectified frame has its x axis along the baseline and its z axis between both optical
axes. Both rectified cameras share the rotation, the focal length and the principal row, but
not the principal column: a strongly verged rig looks at one place from both sides, and a
common principal column would push that place out of both images.

`StereoImages` is one exposure, raw and rectified.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np

from edged.domain.arrays import F32, FloatArray, Image, Side
from edged.errors import CalibrationError, ImageError
from edged.vision.geometry.camera import CameraModel, StereoRig, squares
from edged.vision.geometry.params import RECTIFICATION

Maps = tuple[F32, F32]


@dataclass(frozen=True, eq=False)  # no slots: cached properties live in the instance's dictionary
class Rectification:
    """Two ideal cameras side by side, and the mapping from the raw images to theirs.

    size (w, h) of both rectified images.  focal_px, for x and y.
    centre_left_px, centre_right_px (cx, cy): principal points; cy is the same.
    baseline_mm : the right camera lies at (baseline_mm, 0, 0) of the rectified frame.
    rectified_from_left, rectified_from_right (3, 3): rotations.
    maps_left, maps_right : raw x and y (h, w) float32 of each rectified pixel; computed on first use, as they
    are as large as eight images, and a cell needs only those of its left camera.
    valid_left, valid_right (h, w) uint8 : 255 where the raw image has a value, else 0.
    borrowed : rectification whose maps are used; None: its own.

    A point with rectified columns x_l, x_r on one row has the parallax
    (x_l - cx_l) - (x_r - cx_r) = focal_px baseline_mm / Z_rectified.
    """

    rig: StereoRig
    size: tuple[int, int]
    focal_px: float
    centre_left_px: tuple[float, float]
    centre_right_px: tuple[float, float]
    baseline_mm: float
    rectified_from_left: FloatArray
    rectified_from_right: FloatArray
    borrowed: Rectification | None = None

    def near(self, rig: StereoRig) -> Rectification:
        """The rectification of a slightly different rig, with the image maps of this one.

        Points are exact; images are off by as much as the rigs differ, but need no new maps.
        Raises `CalibrationError`.
        """
        left_axes = _rectified_axes(rig)
        return replace(
            self,
            rig=rig,
            baseline_mm=rig.baseline_mm,
            rectified_from_left=left_axes,
            rectified_from_right=left_axes @ rig.right_from_left[:3, :3].T,
            borrowed=self.pictured,
        )

    @property
    def pictured(self) -> Rectification:
        """The rectification whose maps are used for images: this one, or the one that it borrows from."""
        return self if self.borrowed is None else self.borrowed

    @property
    def maps_left(self) -> Maps:
        """Rectifying maps of the left image, read-only."""
        return self._left[0]

    @property
    def maps_right(self) -> Maps:
        """Rectifying maps of the right image, read-only."""
        return self._right[0]

    @property
    def valid_left(self) -> Image:
        """Mask of valid pixels of the rectified left image, read-only."""
        return self._left[1]

    @property
    def valid_right(self) -> Image:
        """Mask of valid pixels of the rectified right image, read-only."""
        return self._right[1]

    @cached_property
    def _left(self) -> tuple[Maps, Image]:
        if self.borrowed is not None:
            return self.borrowed.maps_left, self.borrowed.valid_left
        return lens_maps(
            self.rig.left, self.rectified_from_left, self.focal_px, self.centre_left_px, self.size
        )

    @cached_property
    def _right(self) -> tuple[Maps, Image]:
        if self.borrowed is not None:
            return self.borrowed.maps_right, self.borrowed.valid_right
        return lens_maps(
            self.rig.right, self.rectified_from_right, self.focal_px, self.centre_right_px, self.size
        )

    def left_image(self, image: Image) -> Image:
        """The rectified left image (h, w); pixels outside the raw image are 0."""
        return self._remap(self.rig.left, self.maps_left, image, "left")

    def right_image(self, image: Image) -> Image:
        """The rectified right image (h, w); pixels outside the raw image are 0."""
        return self._remap(self.rig.right, self.maps_right, image, "right")

    def rectify_points(self, side: Side, pixels: FloatArray) -> FloatArray:
        """Rectified points (..., 2) of raw image points (..., 2); exact, needs no image."""
        camera, rotation, centre = self._view(side)
        return _rays_to_pixels(rotation, camera.normalise(pixels)) * self.focal_px + centre

    def rectified(self, side: Side, points_mm: FloatArray) -> FloatArray:
        """Rectified points (..., 2) of points (..., 3) in the raw camera's frame."""
        _, rotation, centre = self._view(side)
        return _rays_to_pixels(rotation, points_mm[..., :2] / points_mm[..., 2:]) * self.focal_px + centre

    def raw_points(self, side: Side, rectified: FloatArray) -> FloatArray:
        """Raw image points (..., 2) of rectified points (..., 2): the inverse of `rectify_points`.

        NaN where the raw camera cannot see in that direction.
        """
        return self._view(side)[0].pixels(self.directions(side, rectified))

    def directions(self, side: Side, rectified: FloatArray) -> FloatArray:
        """Undistorted normalised points (..., 2) of the raw camera for rectified ones; NaN as there."""
        camera, rotation, centre = self._view(side)
        ideal = (np.asarray(rectified, dtype=np.float64) - centre) / self.focal_px
        return _within_lens(camera, _rays_to_pixels(rotation.T, ideal))

    def disparity_px(self, depth_mm: float) -> float:
        """x_left - x_right in rectified pixels of a point at this depth of the rectified frame."""
        offset = self.centre_left_px[0] - self.centre_right_px[0]
        return self.focal_px * self.baseline_mm / depth_mm + offset

    def _view(self, side: Side) -> tuple[CameraModel, FloatArray, tuple[float, float]]:
        if side == "left":
            return self.rig.left, self.rectified_from_left, self.centre_left_px
        return self.rig.right, self.rectified_from_right, self.centre_right_px

    @staticmethod
    def _remap(
        camera: CameraModel,
        maps: Maps,
        image: Image,
        side: Side,
    ) -> Image:
        check_size(camera, image, side)
        # not cubic: OpenCV rounds its sample positions to 1/32 px, and a Gaussian blob then moves by up to
        # 0.05 px, against 0.02 px with this
        result = cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        return np.asarray(result, dtype=np.uint8)


def check_size(camera: CameraModel, image: Image, side: Side) -> None:
    """Raises `ImageError` for an image that is not one of this camera's, 8-bit grey."""
    if image.dtype != np.uint8:
        raise ImageError(f"{side} image: {image.dtype} pixels, expected 8-bit grey")
    if image.shape != (camera.height, camera.width):
        found = "x".join(str(n) for n in reversed(image.shape))
        wanted = f"{camera.width}x{camera.height}"
        text = f"{side} image: {found}, the rig was calibrated for {wanted}"
        raise ImageError(text, "size", side=side, found=found, wanted=wanted)


def make_rectification(rig: StereoRig) -> Rectification:
    """Choose the rectified cameras of a rig.

    The z axis bisects the angle between both optical axes, the focal length keeps the mean pixel area of the
    raw images at their centres, the rows are those that both views share, and the columns contain each view
    completely, so that no point seen by both is lost. Wide-angle views whose corners would make the images
    huge get a shorter focal length.
    Raises `CalibrationError` for a rig whose views cannot be put side by side (one camera
    looks along the baseline, or both share no row).
    """
    left_axes, right_axes, focal = _common_view(rig)
    bounds_left = border_bounds(rig.left, left_axes) * focal
    bounds_right = border_bounds(rig.right, right_axes) * focal
    top, bottom = max(bounds_left[0, 1], bounds_right[0, 1]), min(bounds_left[1, 1], bounds_right[1, 1])
    width, height = _size(bounds_left, bounds_right)
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    centre_y = float(middle[1] - 0.5 * (top + bottom))
    centre_left = (float(middle[0] - bounds_left[:, 0].mean()), centre_y)
    centre_right = (float(middle[0] - bounds_right[:, 0].mean()), centre_y)
    return Rectification(
        rig=rig,
        size=(width, height),
        focal_px=focal,
        centre_left_px=centre_left,
        centre_right_px=centre_right,
        baseline_mm=rig.baseline_mm,
        rectified_from_left=left_axes,
        rectified_from_right=right_axes,
    )


def row_difference_px(rig: StereoRig, left_px: FloatArray, right_px: FloatArray) -> FloatArray:
    """Rectified row of raw left points (N, 2) minus that of raw right points (N, 2): the epipolar error.

    In rectified pixels of the focal length `make_rectification` chooses; needs no maps.
    """
    left_axes, right_axes, focal = _common_view(rig)
    left = _rays_to_pixels(left_axes, rig.left.normalise(left_px))
    right = _rays_to_pixels(right_axes, rig.right.normalise(right_px))
    return np.asarray(focal * (left[:, 1] - right[:, 1]))


def can_be_rectified(rig: StereoRig) -> bool:
    """Whether both images, up to their corners, have a common view."""
    try:
        _common_view(rig)
    except CalibrationError:
        return False
    return True


def _common_view(rig: StereoRig) -> tuple[FloatArray, FloatArray, float]:
    """Both rotations into the rectified frame, and its focal length in px."""
    left_axes = _rectified_axes(rig)
    right_axes = left_axes @ rig.right_from_left[:3, :3].T
    focal = 0.5 * (_focal_keeping_area(rig.left, left_axes) + _focal_keeping_area(rig.right, right_axes))
    width, height = _size(
        border_bounds(rig.left, left_axes) * focal, border_bounds(rig.right, right_axes) * focal
    )
    raw = max(rig.left.width * rig.left.height, rig.right.width * rig.right.height)
    shrink = min(1.0, float(np.sqrt(RECTIFICATION.max_growth * raw / (width * height))))
    if shrink < RECTIFICATION.min_shrink:
        raise CalibrationError(
            f"this rig cannot be rectified: its views would need {width} x {height} px; "
            "do both cameras look across the baseline?"
        )
    return left_axes, right_axes, focal * shrink


def _size(bounds_left: FloatArray, bounds_right: FloatArray) -> tuple[int, int]:
    """(width, height) in px that contains both views' columns and their common rows."""
    top, bottom = max(bounds_left[0, 1], bounds_right[0, 1]), min(bounds_left[1, 1], bounds_right[1, 1])
    if not bottom - top >= RECTIFICATION.size_multiple:
        raise CalibrationError("this rig cannot be rectified: both cameras see no common row")
    span = np.array([max(np.ptp(bounds_left[:, 0]), np.ptp(bounds_right[:, 0])), bottom - top])
    # rounded up to the multiple, with the half pixel on each side that a pixel centre needs
    width, height = (
        int(n) for n in np.ceil((span + 1) / RECTIFICATION.size_multiple) * RECTIFICATION.size_multiple
    )
    return width, height


def _rectified_axes(rig: StereoRig) -> FloatArray:
    """Rows: the rectified x, y, z axes in the left camera's frame."""
    left_from_right = rig.right_from_left[:3, :3].T
    baseline = -left_from_right @ rig.right_from_left[:3, 3]
    x_axis = baseline / np.linalg.norm(baseline)
    forward = np.array([0.0, 0.0, 1.0]) + left_from_right[:, 2]
    z_axis = forward - x_axis * (x_axis @ forward)
    length = float(np.linalg.norm(z_axis))
    if length < 0.2:  # of at most 2: the mean view is within 6° of the baseline
        raise CalibrationError("this rig cannot be rectified: its cameras look along the baseline")
    z_axis = z_axis / length
    return np.stack([x_axis, np.cross(z_axis, x_axis), z_axis])


def _focal_keeping_area(camera: CameraModel, axes: FloatArray) -> float:
    """Focal length in px at which the image centre keeps its pixel area."""
    centre = np.array([(camera.width - 1) / 2, (camera.height - 1) / 2])
    step = np.array([[-0.5, 0.0], [0.5, 0.0], [0.0, -0.5], [0.0, 0.5]])
    mapped = _rays_to_pixels(axes, camera.normalise(centre + step))
    across, down = mapped[1] - mapped[0], mapped[3] - mapped[2]
    area = across[0] * down[1] - across[1] * down[0]
    if not area > 0:  # also NaN, when the centre ends up behind
        raise CalibrationError("this rig cannot be rectified: a camera looks away from the common view")
    return float(1 / np.sqrt(area))


def border_bounds(camera: CameraModel, axes: FloatArray) -> FloatArray:
    """((x_min, y_min), (x_max, y_max)) of the raw image's border at focal length 1."""
    u = np.linspace(0, camera.width - 1, RECTIFICATION.border_points)
    v = np.linspace(0, camera.height - 1, RECTIFICATION.border_points)
    border = np.concatenate(
        [np.stack(np.broadcast_arrays(u, edge), axis=-1) for edge in (0.0, camera.height - 1.0)]
        + [np.stack(np.broadcast_arrays(edge, v), axis=-1) for edge in (0.0, camera.width - 1.0)]
    )
    mapped = _rays_to_pixels(axes, camera.normalise(border))
    if not np.isfinite(mapped).all():
        raise CalibrationError(
            "this rig cannot be rectified: a camera sees more than 90° off the common view"
        )
    return np.stack([mapped.min(axis=0), mapped.max(axis=0)])


def _rays_to_pixels(rotation: FloatArray, normalised: FloatArray) -> FloatArray:
    """Rotate the rays (x, y, 1) of normalised points (..., 2); NaN for those that end up behind."""
    # no matrix product, as its result would be interleaved: points keep their layout in memory
    normalised = np.asarray(normalised, dtype=np.float64)
    x, y = normalised[..., 0], normalised[..., 1]
    depth = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2]
    depth = np.where(depth > 1e-6, depth, np.nan)
    turned = np.empty_like(normalised)
    for axis in (0, 1):
        turned[..., axis] = (rotation[axis, 0] * x + rotation[axis, 1] * y + rotation[axis, 2]) / depth
    return turned


def _within_lens(camera: CameraModel, normalised: FloatArray) -> FloatArray:
    """Normalised points (..., 2), NaN beyond the radius where the lens model would fold back."""
    limit = _fold_radius2(camera)
    if limit == np.inf:
        return normalised
    return np.where(squares(normalised) < limit, normalised, np.nan)


@lru_cache(maxsize=16)
def _fold_radius2(camera: CameraModel) -> float:
    """Squared undistorted radius up to which the model's radius grows; inf if it always does."""
    if camera.model != "brown":
        kappa = camera.distortion[0]
        return 1.0 / (4.0 * kappa) if kappa > 0.0 else np.inf
    k1, k2, _, _, k3 = camera.distortion
    roots = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])
    turning = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
    return float(turning.min()) if turning.size else np.inf


def lens_maps(
    camera: CameraModel,
    axes: FloatArray,
    focal: float | FloatArray,
    centre: tuple[float, float],
    size: tuple[int, int],
) -> tuple[Maps, Image]:
    """Maps from an ideal image without distortion to a camera's image, and a mask, 255 for valid pixels.

    axes (3, 3) : those of the ideal camera, in the camera's frame.  focal : px, one or (2,).  centre, size :
    px.
    """
    (width, height), (fx, fy) = size, np.broadcast_to(focal, 2)
    # far outside instead of NaN, whose conversion to an integer is undefined in cv2.remap; and never
    # beyond the range of its 16-bit coordinates
    outside = np.float32(-1e4)
    map_x, map_y = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    valid = np.empty((height, width), np.uint8)
    for top in range(0, height, RECTIFICATION.band_rows):
        rows = slice(top, min(top + RECTIFICATION.band_rows, height))
        ideal = np.moveaxis(np.empty((2, rows.stop - top, width)), 0, -1)
        ideal[..., 0] = (np.arange(width) - centre[0]) / fx
        ideal[..., 1] = (np.arange(top, rows.stop)[:, None] - centre[1]) / fy
        raw = camera.pixels(_within_lens(camera, _rays_to_pixels(axes.T, ideal)))
        x, y = raw[..., 0], raw[..., 1]
        with np.errstate(invalid="ignore"):
            valid[rows] = (x >= 0) & (y >= 0) & (x <= camera.width - 1) & (y <= camera.height - 1)
        map_x[rows] = np.where(np.isfinite(x), np.clip(x, -1e4, 3e4), outside)
        map_y[rows] = np.where(np.isfinite(y), np.clip(y, -1e4, 3e4), outside)
    valid *= np.uint8(255)
    for plane in (map_x, map_y, valid):
        plane.flags.writeable = False  # the cycle and the status page read them on threads of their own
    return (map_x, map_y), valid


@dataclass(frozen=True, eq=False)  # no slots: cached properties live in the instance's dictionary
class StereoImages:
    """Raw images (H, W) and rectified ones (h, w), uint8, with the rectification between them.

    Their grey values are proportional to the light: the response of the cameras is removed. An image is
    rectified on demand: finding a part needs the left one, measuring it needs neither.
    """

    rectification: Rectification
    left: Image
    right: Image

    @staticmethod
    def of(rectification: Rectification, left: Image, right: Image) -> StereoImages:
        """Take a raw pair. Raises `ImageError` for images that the rig was not calibrated for."""
        return StereoImages(rectification, *linear_pair(rectification.rig, left, right))

    @cached_property
    def rectified_left(self) -> Image:
        """The left image as the rectified camera sees it."""
        return self.rectification.left_image(self.left)

    @cached_property
    def rectified_right(self) -> Image:
        """The right image as the rectified camera sees it."""
        return self.rectification.right_image(self.right)

    @property
    def rig(self) -> StereoRig:
        """The cameras as calibrated."""
        return self.rectification.rig

    @property
    def raw(self) -> tuple[Image, Image]:
        """Left and right, not rectified."""
        return self.left, self.right

    def rays(self, side: Side, rectified_px: FloatArray) -> FloatArray:
        """Directions (N, 3), z = 1 in the raw camera's frame, of rectified pixels (N, 2) of one image."""
        rays = np.empty((len(rectified_px), 3))
        rays[:, :2], rays[:, 2] = self.rectification.directions(side, rectified_px), 1.0
        return rays


def linear_image(image: Image, gamma: float) -> Image:
    """An image (H, W) uint8 with grey values proportional to the light; unchanged for a linear camera."""
    if gamma == 1.0:
        return image
    return np.asarray(cv2.LUT(image, _inverse(gamma)), np.uint8)


def linear_pair(rig: StereoRig, left: Image, right: Image) -> tuple[Image, Image]:
    """Both images as `linear_image`. Raises `ImageError` for images that the rig was not calibrated for."""
    check_size(rig.left, left, "left")
    check_size(rig.right, right, "right")
    return linear_image(left, rig.left.gamma), linear_image(right, rig.right.gamma)


@lru_cache(maxsize=8)
def _inverse(gamma: float) -> Image:
    """(256,) uint8: table of linear grey values."""
    return np.rint(linear_grey(np.arange(256.0), gamma)).astype(np.uint8)


def linear_grey(grey: FloatArray, gamma: float) -> FloatArray:
    """Grey values, 0 to 255, made proportional to the light."""
    return np.asarray(255.0 * (grey / 255.0) ** (1.0 / gamma))
