"""Kernels of the renderer: distances to outlines, exact coverage of pixels, radiance, exposure.

The picture is a stack of planar layers, each painted with shapes in order. A tile of pixels that
lies entirely inside or outside a shape is decided by one signed distance. Only pixels crossed by an
edge are divided into CELLS x CELLS cells, and the coverage of each cell is that of the half-plane
fitted to the distances at its corners, whose area has a closed form. The remaining error is the
sagitta of an edge within a cell: 0.0003 px for a radius of 30 px.

A lens blurs before the pixels sample. Blurring the averages of pixels instead would move edges along rows or
columns by up to 0.02 px, all marks on a row or column alike; so each cell is blurred from its own position.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from edged.domain.arrays import F32, F64, I64
from edged.vision.kernels.jit import kernel

TILE = 16
CELLS = 4
TEXTURE_SIZE = 1024  # texels, a power of two: wrapping is a mask

# columns of a shape: kind, centre, direction of its x axis, four parameters, paint
KIND, CX, CY, COS, SIN, P0, P1, P2, P3, ALBEDO, CONTRAST, TRANSMISSION = range(12)
SHAPE_COLUMNS = 12
PLANE, DISC, BOX, POLYGON, CHECKER, DOTS = range(6)

# columns of a layer: (u, v, 1) ~ homography (x, y, 1); irradiance = a + b u + c v; texture and its lay: along
# an angle (COS, SIN) or, if RADIUS is not 0, on arcs about a point, with the nominal scale at that radius
HOMOGRAPHY, IRRADIANCE, TEXTURE, TEXELS_U, TEXELS_V, FIRST, END = 0, 9, 12, 13, 14, 15, 16
LAY_COS, LAY_SIN, LAY_U, LAY_V, LAY_RADIUS = 17, 18, 19, 20, 21
LAYER_COLUMNS = 22

MIXED, NOTHING = -1, -2
BEHIND, PAINTED, DIVIDED = range(3)


@kernel()
def _box(x: float, y: float, half_x: float, half_y: float, corner: float) -> float:
    qx = abs(x) - half_x + corner
    qy = abs(y) - half_y + corner
    outside = math.sqrt(max(qx, 0.0) ** 2 + max(qy, 0.0) ** 2)
    return outside + min(max(qx, qy), 0.0) - corner


@kernel()
def _polygon(x: float, y: float, vertices: F64, first: int, count: int) -> float:
    nearest2 = np.inf
    inside = False
    for i in range(count):
        ax, ay = vertices[first + i]
        bx, by = vertices[first + (i + 1) % count]
        ex, ey = bx - ax, by - ay
        t = ((x - ax) * ex + (y - ay) * ey) / (ex * ex + ey * ey)
        t = min(max(t, 0.0), 1.0)
        dx, dy = x - ax - t * ex, y - ay - t * ey
        nearest2 = min(nearest2, dx * dx + dy * dy)
        if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * ex:
            inside = not inside
    return -math.sqrt(nearest2) if inside else math.sqrt(nearest2)


@kernel()
def _checker(x: float, y: float, square: float, columns: int, rows: int) -> float:
    """Signed distance to dark squares, where column + row is even; (0, 0) is the corner of the field."""
    i = min(max(math.floor(x / square), 0), columns - 1)
    j = min(max(math.floor(y / square), 0), rows - 1)
    nearest = np.inf
    for dj in range(-1, 2):
        for di in range(-1, 2):
            column, row = i + di, j + dj
            if 0 <= column < columns and 0 <= row < rows and (column + row) % 2 == 0:
                half = 0.5 * square
                distance = _box(x - (column + 0.5) * square, y - (row + 0.5) * square, half, half, 0.0)
                nearest = min(nearest, distance)
    return nearest


@kernel(inline=True)
def signed_distance(u: float, v: float, shapes: F64, s: int, vertices: F64) -> float:
    """Signed distance in mm of a point of the plane from the outline of shape s; negative inside."""
    kind = int(shapes[s, KIND])
    if kind == PLANE:
        return -np.inf
    du, dv = u - shapes[s, CX], v - shapes[s, CY]
    x = shapes[s, COS] * du + shapes[s, SIN] * dv
    y = shapes[s, COS] * dv - shapes[s, SIN] * du
    p0, p1, p2, p3 = shapes[s, P0], shapes[s, P1], shapes[s, P2], shapes[s, P3]
    if kind == DISC:
        return float(math.sqrt(x * x + y * y) - p0)
    if kind == BOX:
        return _box(x, y, p0, p1, p2)
    if kind == POLYGON:
        return _polygon(x, y, vertices, int(p0), int(p1))
    if kind == CHECKER:
        return _checker(x, y, p0, int(p1), int(p2))
    i = min(max(math.floor(x / p1 + 0.5), 0.0), p2 - 1.0)
    j = min(max(math.floor(y / p1 + 0.5), 0.0), p3 - 1.0)
    return float(math.sqrt((x - i * p1) ** 2 + (y - j * p1) ** 2) - p0)


@kernel("f8(f8, f8, f8)")
def half_plane_coverage(distance: float, slope_x: float, slope_y: float) -> float:
    """Area [0, 1] of the unit cell |x|, |y| <= 1/2 in which distance + slope_x x + slope_y y < 0."""
    a, b = max(abs(slope_x), abs(slope_y)), min(abs(slope_x), abs(slope_y))
    rest = 0.5 * (a + b) - abs(distance)
    if rest <= 0.0:
        return 1.0 if distance < 0.0 else 0.0
    # a line through opposite sides cuts off a trapezium, one near a corner a triangle
    far = 0.5 - abs(distance) / a if rest >= b else rest * rest / (2.0 * a * b)
    return 1.0 - far if distance < 0.0 else far


@kernel(inline=True)
def _texture(textures: F32, t: int, u: float, v: float) -> float:
    """Bilinear sample of periodic tile t."""
    fu, fv = math.floor(u), math.floor(v)
    i, row = int(fu) & (TEXTURE_SIZE - 1), (int(fv) & (TEXTURE_SIZE - 1)) * TEXTURE_SIZE
    right = (i + 1) & (TEXTURE_SIZE - 1)
    below = (row + TEXTURE_SIZE) & (TEXTURE_SIZE * TEXTURE_SIZE - 1)
    a, b, tile = u - fu, v - fv, t * TEXTURE_SIZE * TEXTURE_SIZE
    corner = textures[tile + row + i]
    top = corner + a * (textures[tile + row + right] - corner)
    corner = textures[tile + below + i]
    bottom = corner + a * (textures[tile + below + right] - corner)
    return float(top + b * (bottom - top))


@kernel(inline=True)
def _grain(textures: F32, layers: F64, n: int, u: float, v: float) -> float:
    """Texture value of layer n at a point of its plane."""
    du, dv = u - layers[n, LAY_U], v - layers[n, LAY_V]
    along, across = layers[n, LAY_COS] * du + layers[n, LAY_SIN] * dv, 0.0
    if layers[n, LAY_RADIUS] > 0.0:
        # symmetric, so that the texture is continuous on the far side of the point
        across = math.sqrt(du * du + dv * dv)
        turn = math.acos(min(max(along / max(across, 1e-9), -1.0), 1.0))
        along = layers[n, LAY_RADIUS] * turn
    else:
        across = layers[n, LAY_COS] * dv - layers[n, LAY_SIN] * du
    return _texture(
        textures, int(layers[n, TEXTURE]), along * layers[n, TEXELS_U], across * layers[n, TEXELS_V]
    )


@kernel()
def _settle_tile(rays: F64, box: I64, layers: F64, n: int, shapes: F64, vertices: F64, states: I64) -> float:
    """Set for each shape of layer n whether a tile is inside (1), outside (0) or mixed (2).

    Returns an upper bound of half a pixel's diagonal in mm; negative if the plane is not in front.
    """
    y0, y1, x0, x1 = box[0], box[1], box[2], box[3]
    corner_u, corner_v = np.empty(4), np.empty(4)
    for k in range(4):
        y, x = y0 if k < 2 else y1 - 1, x0 if k % 2 == 0 else x1 - 1
        a, b = rays[y, x, 0], rays[y, x, 1]
        w = layers[n, 6] * a + layers[n, 7] * b + layers[n, 8]
        if w <= 0.0:
            return -1.0
        corner_u[k] = (layers[n, 0] * a + layers[n, 1] * b + layers[n, 2]) / w
        corner_v[k] = (layers[n, 3] * a + layers[n, 4] * b + layers[n, 5]) / w
    u, v = corner_u.mean(), corner_v.mean()
    radius = math.sqrt(np.max((corner_u - u) ** 2 + (corner_v - v) ** 2))
    # 1.3: perspective and distortion within a tile make some pixels larger than the mean;
    # a tile's corners are pixel centres, hence - 1
    pixel = 1.3 * radius / (max(y1 - y0, x1 - x0) - 1)
    for s in range(int(layers[n, FIRST]), int(layers[n, END])):
        distance = signed_distance(u, v, shapes, s, vertices)
        if abs(distance) > 1.05 * radius + pixel:
            states[s] = 1 if distance < 0.0 else 0
        else:
            states[s] = 2
    return float(pixel)


@kernel(inline=True)
def _cell_corners(rays: F64, y: int, x: int, layers: F64, n: int, corners: F64) -> None:
    """Points of layer n's plane at the (CELLS + 1)² corners of a pixel's cells."""
    last_y, last_x = rays.shape[0] - 1, rays.shape[1] - 1
    below, above = min(y + 1, last_y), max(y - 1, 0)
    right, left = min(x + 1, last_x), max(x - 1, 0)
    k = 0
    for j in range(CELLS + 1):
        oy = (j / CELLS - 0.5) / (below - above)
        for i in range(CELLS + 1):
            ox = (i / CELLS - 0.5) / (right - left)
            # distortion within a pixel is nonlinear by 1e-5 px only: a linear step suffices
            a = rays[y, x, 0] + ox * (rays[y, right, 0] - rays[y, left, 0])
            a += oy * (rays[below, x, 0] - rays[above, x, 0])
            b = rays[y, x, 1] + ox * (rays[y, right, 1] - rays[y, left, 1])
            b += oy * (rays[below, x, 1] - rays[above, x, 1])
            w = layers[n, 6] * a + layers[n, 7] * b + layers[n, 8]
            corners[0, k] = (layers[n, 0] * a + layers[n, 1] * b + layers[n, 2]) / w
            corners[1, k] = (layers[n, 3] * a + layers[n, 4] * b + layers[n, 5]) / w
            k += 1


@kernel(inline=True)
def _paint_cells(corners: F64, shapes: F64, s: int, vertices: F64, paint: float, cells: F64) -> None:
    """Blend the paint of shape s into the cells of one pixel by its coverage of each."""
    for k in range(corners.shape[1]):
        corners[2, k] = signed_distance(corners[0, k], corners[1, k], shapes, s, vertices)
    stride = CELLS + 1
    for j in range(CELLS):
        for i in range(CELLS):
            k = j * stride + i
            d00, d10 = corners[2, k], corners[2, k + 1]
            d01, d11 = corners[2, k + stride], corners[2, k + stride + 1]
            covered = half_plane_coverage(
                0.25 * (d00 + d10 + d01 + d11), 0.5 * (d10 + d11 - d00 - d01), 0.5 * (d01 + d11 - d00 - d10)
            )
            cells[j * CELLS + i] += covered * (paint - cells[j * CELLS + i])


@kernel()
def _paint_tile(
    rays: F64, box: I64, layers: F64, n: int, shapes: F64, s: int, textures: F32, radiance: F32
) -> None:
    """Paint a whole tile with shape s of layer n."""
    h0, h1, h2 = layers[n, 0], layers[n, 1], layers[n, 2]
    h3, h4, h5 = layers[n, 3], layers[n, 4], layers[n, 5]
    h6, h7, h8 = layers[n, 6], layers[n, 7], layers[n, 8]
    albedo, contrast, transmission = shapes[s, ALBEDO], shapes[s, CONTRAST], shapes[s, TRANSMISSION]
    level, slope_u, slope_v = layers[n, IRRADIANCE], layers[n, IRRADIANCE + 1], layers[n, IRRADIANCE + 2]
    for y in range(box[0], box[1]):
        for x in range(box[2], box[3]):
            a, b = rays[y, x, 0], rays[y, x, 1]
            w = 1.0 / (h6 * a + h7 * b + h8)
            u, v = (h0 * a + h1 * b + h2) * w, (h3 * a + h4 * b + h5) * w
            reflected = albedo
            if contrast != 0.0:
                reflected *= max(1.0 + contrast * _grain(textures, layers, n, u, v), 0.0)
            light = max(level + slope_u * u + slope_v * v, 0.0)
            radiance[y, x] = reflected * light + transmission * radiance[y, x]


class _Stack(NamedTuple):
    """The scene as arrays, see `render_radiance`."""

    rays: F64
    layers: F64
    shapes: F64
    vertices: F64
    textures: F32


class _Divided(NamedTuple):
    """A pixel divided into cells: corners (3, N) with u, v and distance; radiance of each cell."""

    corners: F64
    cells: F64


@kernel(inline=True)
def _paint_pixel(
    stack: _Stack, y: int, x: int, n: int, pixel_mm: float, states: I64, behind: float, pixel: _Divided
) -> tuple[float, int]:
    """Radiance of one pixel after painting layer n over what is behind it, and a state.

    The state is BEHIND (unchanged), PAINTED (entirely), or DIVIDED with the radiance of the cells in `pixel`.
    """
    rays, layers, shapes, vertices, textures = stack
    corners, cells = pixel
    first, end = int(layers[n, FIRST]), int(layers[n, END])
    a, b = rays[y, x, 0], rays[y, x, 1]
    w = layers[n, 6] * a + layers[n, 7] * b + layers[n, 8]
    u = (layers[n, 0] * a + layers[n, 1] * b + layers[n, 2]) / w
    v = (layers[n, 3] * a + layers[n, 4] * b + layers[n, 5]) / w
    light = max(layers[n, IRRADIANCE] + layers[n, IRRADIANCE + 1] * u + layers[n, IRRADIANCE + 2] * v, 0.0)
    grain = _grain(textures, layers, n, u, v)
    value, divided = behind, False
    for s in range(first, end):
        state = states[s]
        if state == 2:
            distance = signed_distance(u, v, shapes, s, vertices)
            if abs(distance) > pixel_mm:
                state = 1 if distance < 0.0 else 0
        if state == 0 and s == first:
            return behind, BEHIND  # outside of its outline the layer is empty
        if state == 0:
            continue
        reflected = shapes[s, ALBEDO] * max(1.0 + shapes[s, CONTRAST] * grain, 0.0)
        paint = reflected * light + shapes[s, TRANSMISSION] * behind
        if state == 1:
            value, divided = paint, False
            continue
        if not divided:
            cells[:] = value
            _cell_corners(rays, y, x, layers, n, corners)
            divided = True
        _paint_cells(corners, shapes, s, vertices, paint, cells)
    if divided:
        return cells.mean(), DIVIDED
    return value, PAINTED


@kernel(inline=True)
def _spread_cells(cells: F64, mean: float, y: int, x: int, spread: F64, of_rows: F64, detail: F32) -> None:
    """Add the blurred deviation of one pixel's cells from their mean to the pixels around it."""
    reach = spread.shape[1] // 2
    for j in range(CELLS):
        for t in range(2 * reach + 1):
            of_rows[j, t] = 0.0
        for i in range(CELLS):
            more = cells[j * CELLS + i] - mean
            for t in range(2 * reach + 1):
                of_rows[j, t] += more * spread[i, t]
    for s in range(max(-reach, -y), min(reach, detail.shape[0] - 1 - y) + 1):
        for t in range(max(-reach, -x), min(reach, detail.shape[1] - 1 - x) + 1):
            more = 0.0
            for j in range(CELLS):
                more += spread[j, s + reach] * of_rows[j, t + reach]
            detail[y + s, x + t] += more


@kernel()
def _shown(layers: F64, n: int, states: I64) -> int:
    """Index of the shape that fills the whole tile, MIXED, or NOTHING outside the layer's outline."""
    first, end = int(layers[n, FIRST]), int(layers[n, END])
    if states[first] == 0:
        return NOTHING
    top = first
    for s in range(first, end):
        if states[s] == 2:
            return MIXED
        if states[s] == 1:
            top = s
    return top


@kernel(
    "void(f8[:, :, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f4[::1], f8[:, ::1], f4[:, ::1], f4[:, ::1])"
)
def render_radiance(
    rays: F64, layers: F64, shapes: F64, vertices: F64, textures: F32, spread: F64, radiance: F32, detail: F32
) -> None:
    """Compute the mean radiance of every pixel for a stack of planar layers, lowest first.

    rays (H, W, 2): (X/Z, Y/Z) of each pixel's centre. layers (L, LAYER_COLUMNS),
    shapes (S, SHAPE_COLUMNS): the first shape of a layer is its outline, which must contain the others;
    vertices (V, 2), textures: T tiles of TEXTURE_SIZE x TEXTURE_SIZE, flat.
    spread (CELLS, 2 R + 1) : contribution of a cell in each column (or row) of its pixel to the pixels from
    R before to R after; of zero width without blur.
    radiance (H, W) is written: outlines by exact area, texture at the pixel's centre. To detail (H, W) the
    difference is added between the blurred cells and their blurred pixel means.
    """
    height, width = radiance.shape
    states = np.empty(shapes.shape[0], np.int64)
    pixel_mm = np.empty(layers.shape[0])
    settled = np.empty(layers.shape[0], np.int64)  # shape that fills the tile in a layer, or MIXED, NOTHING
    stack = _Stack(rays, layers, shapes, vertices, textures)
    pixel = _Divided(np.empty((3, (CELLS + 1) ** 2)), np.empty(CELLS**2))
    tile_cells, is_divided = np.empty((TILE, TILE, CELLS**2)), np.zeros((TILE, TILE), np.bool_)
    of_rows = np.empty((CELLS, spread.shape[1]))
    box = np.empty(4, np.int64)
    for y0 in range(0, height, TILE):
        for x0 in range(0, width, TILE):
            # tiles at the far borders overlap others, so that none is a single pixel
            top, left = max(min(y0, height - TILE), 0), max(min(x0, width - TILE), 0)
            box[:] = (top, min(top + TILE, height), left, min(left + TILE, width))
            start = 0  # topmost layer that hides all others below it
            for n in range(layers.shape[0]):
                pixel_mm[n] = _settle_tile(rays, box, layers, n, shapes, vertices, states)
                settled[n] = _shown(layers, n, states) if pixel_mm[n] >= 0.0 else NOTHING
                if settled[n] >= 0 and shapes[settled[n], TRANSMISSION] == 0.0:
                    start = n
            radiance[top : box[1], left : box[3]] = 0.0
            is_divided[:] = False
            for n in range(start, layers.shape[0]):
                if settled[n] >= 0:
                    is_divided[:] = False
                    _paint_tile(rays, box, layers, n, shapes, settled[n], textures, radiance)
                elif settled[n] == MIXED:
                    for y in range(box[0], box[1]):
                        for x in range(box[2], box[3]):
                            behind = radiance[y, x]
                            radiance[y, x], painted = _paint_pixel(
                                stack, y, x, n, pixel_mm[n], states, behind, pixel
                            )
                            if painted == DIVIDED:
                                tile_cells[y - top, x - left] = pixel.cells
                            if painted != BEHIND:
                                is_divided[y - top, x - left] = painted == DIVIDED
            if spread.shape[1]:
                for y in range(y0, box[1]):
                    for x in range(x0, box[3]):
                        if is_divided[y - top, x - left]:
                            divided = tile_cells[y - top, x - left]
                            _spread_cells(divided, radiance[y, x], y, x, spread, of_rows, detail)


@kernel("void(f4[:, ::1], u2[:, ::1], f4[::1], f8, f8, f8, f8, u1[:, ::1])")
def expose(
    radiance: F32,
    chance: npt.NDArray[np.uint16],
    quantiles: F32,
    electrons: float,
    read_noise_e: float,
    grey_per_electron: float,
    black: float,
    image: npt.NDArray[np.uint8],
) -> None:
    """Grey values of a sensor: shot and read noise, gain, black level, rounding, saturation.

    chance : 16 random bits per pixel, which select one of the 65536 quantiles of the noise.
    electrons : collected per unit of radiance.
    """
    scale, shift = np.float32(electrons * grey_per_electron), np.float32(black + 0.5)
    read2, per_electron = np.float32(read_noise_e * read_noise_e), np.float32(electrons)
    noise_scale = np.float32(grey_per_electron)
    darkest, brightest = np.float32(0.0), np.float32(255.0)
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            value = radiance[y, x]
            noise = quantiles[chance[y, x]] * np.sqrt(value * per_electron + read2)
            grey = value * scale + noise * noise_scale + shift
            image[y, x] = np.uint8(min(max(grey, darkest), brightest))
