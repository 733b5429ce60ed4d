"""The exhaustive part of the search: every pose of a grid at every second pixel of the top level.

Gradient directions are quantised into 16 response maps round(7 cos(direction - orientation)), so that
the similarity of a pose (C. Steger, 2002; paper, eq. 7) is a sum of bytes. Each map is split into four
grids by the parity of x and y: for one point of the model all positions then lie side by side in memory,
and the sum runs at the full width of the SIMD unit (S. Hinterstoisser et al., PAMI 2012, "linear
memories").
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from edged.vision.kernels.jit import kernel

ORIENTATIONS = 16  # maps; their layout is the kernel's
PEAK = 7  # response of full agreement
GROUP = 16  # points whose responses fit into a signed byte together
SECTORS = 12  # of 30°: a pose is never hidden by a rival in another sector
TOP_POINTS = 96  # a multiple of GROUP
BLOCK = 512  # positions per block: few enough that the points of one pose stay in the first-level cache

SPREAD = 3 * PEAK * 0.45
"""Three sigma of the sum over a random part of the points: a response varies by at most 0.45 of its peak
around its mean when half of the points agree, as on a part hidden by half."""

Array = npt.NDArray[Any]


def map_geometry(height: int, width: int, reach: int) -> tuple[int, int, int]:
    """(rows, columns, pad) of one parity grid for points at most `reach` px from the origin.

    The zeros left of a row also serve the row above, whose points leave on the right.
    """
    pad = 2 * (reach // 2 + 2)
    columns = (width + 1) // 2 + pad // 2 + 2
    return (height + 1) // 2 + pad + 2, columns, pad


@kernel("void(i2[:, ::1], i2[:, ::1], u1[:, ::1], i8, b1, i8, f4[:, :, :, :, ::1], i1[:, :, :, :, ::1])")
def fill_responses(
    gx: Array,
    gy: Array,
    valid: Array,
    minimum: int,
    unsigned: bool,
    pad: int,
    directions: Array,
    maps: Array,
) -> None:
    """Write the response maps (16, 2, 2, rows, columns) of a gradient image.

    gx, gy : (H, W) int16.  valid : (H, W) uint8, 0 hides a pixel; (1, 1) when all are valid.
    minimum : squared gradient below which there is no edge.  unsigned : cos of twice the angle, blind
    to the sign of the contrast.  pad : even, px of zeros around.  directions (2, 2, 2, rows, columns) :
    scratch, unit gradients in the order of the maps.
    """
    height, width = gx.shape
    masked = valid.shape[0] == height and valid.shape[1] == width
    directions[:] = 0
    for y in range(height):
        for parity in range(2):  # pad is even: so is the parity of x + pad
            u_row = directions[0, y & 1, parity, (y + pad) >> 1, pad >> 1 :]
            v_row = directions[1, y & 1, parity, (y + pad) >> 1, pad >> 1 :]
            for k in range((width + 1 - parity) >> 1):
                x = np.uint64(2 * k + parity)
                a, b = np.float32(gx[y, x]), np.float32(gy[y, x])
                power = a * a + b * b
                seen = power >= minimum and power > 0 and not (masked and valid[y, x] == 0)
                if unsigned:
                    gain = np.float32(1) / power if seen else np.float32(0)
                    u_row[k], v_row[k] = (a * a - b * b) * gain, np.float32(2) * a * b * gain
                else:
                    gain = np.float32(1) / np.sqrt(power) if seen else np.float32(0)
                    u_row[k], v_row[k] = a * gain, b * gain
    # the rows above and below the image stay zero
    first, last = (pad >> 1) * maps.shape[4], ((height + 1 + pad) >> 1) * maps.shape[4]
    for o in range(16):
        angle = (4.0 if unsigned else 2.0) * np.pi * o / 16
        cosine, sine = np.float32(np.cos(angle) * 7), np.float32(np.sin(angle) * 7)
        for parity in range(4):
            target = maps[o, parity >> 1, parity & 1].reshape(-1)
            target[:first] = 0
            target[last:] = 0
            inner = target[first:last]
            u = directions[0, parity >> 1, parity & 1].reshape(-1)[first:last]
            v = directions[1, parity >> 1, parity & 1].reshape(-1)[first:last]
            for i in range(len(inner)):
                # rounds to nearest: truncates after the value is made positive
                inner[i] = np.int32(u[i] * cosine + v[i] * sine + np.float32(8.5)) - 8


@kernel(inline=True)
def add_group(
    maps: Array,
    offsets: Array,
    p: int,
    n: int,
    first: int,
    length: int,
    sums: Array,
    words: Array,
) -> None:
    """Add the responses of points n to n + 15 of pose p at `length` positions from `first` to `words`.

    n = 0 starts from zero.  sums : scratch, int8, of the same length.
    The compiler vectorises it as written here, in one expression: unsigned indices need no check.
    """
    s0 = np.uint64(offsets[p, n] + first)
    s1 = np.uint64(offsets[p, n + 1] + first)
    s2 = np.uint64(offsets[p, n + 2] + first)
    s3 = np.uint64(offsets[p, n + 3] + first)
    s4 = np.uint64(offsets[p, n + 4] + first)
    s5 = np.uint64(offsets[p, n + 5] + first)
    s6 = np.uint64(offsets[p, n + 6] + first)
    s7 = np.uint64(offsets[p, n + 7] + first)
    s8 = np.uint64(offsets[p, n + 8] + first)
    s9 = np.uint64(offsets[p, n + 9] + first)
    s10 = np.uint64(offsets[p, n + 10] + first)
    s11 = np.uint64(offsets[p, n + 11] + first)
    s12 = np.uint64(offsets[p, n + 12] + first)
    s13 = np.uint64(offsets[p, n + 13] + first)
    s14 = np.uint64(offsets[p, n + 14] + first)
    s15 = np.uint64(offsets[p, n + 15] + first)
    for i in range(np.uint64(length)):
        sums[i] = (
            (maps[s0 + i] + maps[s1 + i] + maps[s2 + i] + maps[s3 + i])
            + (maps[s4 + i] + maps[s5 + i] + maps[s6 + i] + maps[s7 + i])
            + (maps[s8 + i] + maps[s9 + i] + maps[s10 + i] + maps[s11 + i])
            + (maps[s12 + i] + maps[s13 + i] + maps[s14 + i] + maps[s15 + i])
        )
    source, target = sums[:length], words[:length]
    if n == 0:
        target[:] = 0
    for i in range(length):
        target[i] += source[i]


@kernel("i8(i2[::1], i8, b1)")
def highest(
    words: Array,
    length: int,
    both: bool,
) -> int:
    """Largest value, or largest magnitude, of the first `length` words."""
    source = words[:length]
    top, bottom = np.int16(-32000), np.int16(32000)
    for i in range(length):
        top = max(top, source[i])
        bottom = min(bottom, source[i])
    return int(max(np.int64(top), -np.int64(bottom)) if both else np.int64(top))


@kernel("void(i1[::1], i8[:, ::1], i8[::1], i8, i8, b1, i2[:, :, ::1], i4[:, :, ::1])")
def scan(
    maps: Array,
    offsets: Array,
    sectors: Array,
    positions: int,
    threshold: int,
    both: bool,
    best: Array,
    pose: Array,
) -> None:
    """Best score and pose per position, sign and sector.

    maps : flat response maps.  offsets : (P, N) where in `maps` each point of each pose begins.
    sectors : (P,) of each pose.  best, pose : (2, number of sectors, positions); best is zero on entry, and
    poses below threshold are not entered.
    """
    count = offsets.shape[1]
    sums, words = np.empty(BLOCK, np.int8), np.empty(BLOCK, np.int16)
    for first in range(0, positions, BLOCK):
        length = min(BLOCK, positions - first)
        for p in range(offsets.shape[0]):
            top = 0
            for n in range(0, count, GROUP):
                add_group(maps, offsets, p, n, first, length, sums, words)
                done = n + GROUP
                if 2 * GROUP <= done <= 4 * GROUP or done == count:
                    top = highest(words, length, both)
                    # points come in random order: the share seen so far predicts the sum to within SPREAD
                    expected = threshold * done / count
                    if top < expected - SPREAD * np.sqrt(done * (1 - done / count)):
                        break
            if top < threshold:
                continue
            s = sectors[p]
            for i in range(length):
                value = words[i]
                if value >= threshold and value > best[0, s, first + i]:
                    best[0, s, first + i] = value
                    pose[0, s, first + i] = p
                elif both and -value >= threshold and -value > best[1, s, first + i]:
                    best[1, s, first + i] = -value
                    pose[1, s, first + i] = p


@kernel("i8(i2[:, :, ::1], i8, i8, i8, i8, i8[:, ::1])")
def collect_peaks(
    best: Array,
    rows: int,
    columns: int,
    stride: int,
    threshold: int,
    peaks: Array,
) -> int:
    """Fill peaks with local maxima (3x3) of best: value, sign, sector, row, column; return their number.

    When there are more than `peaks` holds, the highest are kept, of equal ones the first.
    """
    histogram = np.zeros(PEAK * TOP_POINTS + 2, np.int64)
    cut = threshold
    # three turns: count; enter peaks above the cut; fill up with peaks at it
    number = 0
    for turn in range(3):
        for sign in range(2):
            for sector in range(best.shape[1]):
                score = best[sign, sector]
                for y in range(rows):
                    # most rows hold no peak: their maximum alone takes a tenth of the time
                    if highest(score[y * stride : y * stride + columns], columns, False) < max(cut, 1):
                        continue
                    for x in range(columns):
                        value = score[y * stride + x]
                        if (
                            value < cut
                            or value <= 0
                            or (turn == 1 and value == cut)
                            or (turn == 2 and value != cut)
                        ):
                            continue
                        is_peak = True
                        for dy in range(-1, 2):
                            for dx in range(-1, 2):
                                yy, xx = y + dy, x + dx
                                if (dy == 0 and dx == 0) or not (0 <= yy < rows and 0 <= xx < columns):
                                    continue
                                other = score[yy * stride + xx]
                                # of equal neighbours the first one is the peak
                                if other > value or (other == value and (dy < 0 or (dy == 0 and dx < 0))):
                                    is_peak = False
                        if not is_peak:
                            continue
                        if turn == 0:
                            histogram[min(value, len(histogram) - 1)] += 1
                        elif number < len(peaks):
                            peaks[number, 0] = value
                            peaks[number, 1] = sign
                            peaks[number, 2] = sector
                            peaks[number, 3] = y
                            peaks[number, 4] = x
                            number += 1
        if turn == 0:
            total, cut = 0, len(histogram) - 1
            while cut > threshold and total + histogram[cut] <= len(peaks):
                total += histogram[cut]
                cut -= 1
    return number


@kernel("void(f8[:, ::1], f8[::1], f8, f8, f8, i8, i8[:, ::1])")
def place_on_maps(
    points: Array,
    directions: Array,
    angle: float,
    scale_x: float,
    scale_y: float,
    pad: int,
    placed: Array,
) -> None:
    """Write (x, y, map) of each point of a pose whose origin is pixel (0, 0)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    for n in range(points.shape[0]):
        u, v = points[n, 0] * scale_x, points[n, 1] * scale_y
        placed[n, 0] = int(np.floor(cosine * u - sine * v + 0.5)) + pad
        placed[n, 1] = int(np.floor(sine * u + cosine * v + 0.5)) + pad
        placed[n, 2] = int(np.floor((directions[n] + angle) * (16 / (2 * np.pi)) + 0.5)) & 15


@kernel("i8(i1[:, :, :, :, ::1], i8[:, ::1], i8, i8)")
def response_sum(
    maps: Array,
    placed: Array,
    x: int,
    y: int,
) -> int:
    """Similarity of placed points with the origin at pixel (x, y), any parity."""
    rows, columns = maps.shape[3], maps.shape[4]
    flat, total = maps.reshape(-1), 0
    for n in range(placed.shape[0]):
        px, py = x + placed[n, 0], y + placed[n, 1]
        if px >= 0 and py >= 0 and (py >> 1) < rows and (px >> 1) < columns:
            plane = (placed[n, 2] * 2 + (py & 1)) * 2 + (px & 1)
            # inside the maps, see above: an unsigned number needs no check for a negative index
            total += flat[np.uint64((plane * rows + (py >> 1)) * columns + (px >> 1))]
    return total


@kernel("void(i1[:, :, :, :, ::1], f8[:, ::1], f8[::1], i8, f8[::1], f8[:, ::1], f8[::1])")
def polish(
    maps: Array,
    points: Array,
    directions: Array,
    pad: int,
    steps: Array,
    candidates: Array,
    values: Array,
) -> None:
    """Climb from each candidate: position ±1 px, then angle, x scale, y scale ± half a step, position again.

    steps (3,) : half steps of angle, x scale and y scale; a negative y step ties y to x.
    candidates (N, 6) : x, y, angle, scale x, scale y, sign, changed in place; values (N,) the score reached.
    """
    placed = np.empty((points.shape[0], 3), np.int64)
    trial, pose = np.empty(5), np.empty(5)
    for c in range(candidates.shape[0]):
        sign = int(candidates[c, 5])
        best = -(1 << 30)
        for turn in range(5):
            pose[:] = candidates[c, :5]
            if turn == 0 or turn == 4:
                place_on_maps(points, directions, pose[2], pose[3], pose[4], pad, placed)
                for dy in range(-1, 2):
                    for dx in range(-1, 2):
                        value = sign * response_sum(maps, placed, int(pose[0]) + dx, int(pose[1]) + dy)
                        if value > best:
                            best = value
                            candidates[c, 0], candidates[c, 1] = pose[0] + dx, pose[1] + dy
                continue
            step = steps[turn - 1]
            if step <= 0:
                continue
            for side in range(-1, 2, 2):
                trial[:] = pose
                if turn == 1:
                    trial[2] += side * step
                else:
                    trial[turn + 1] *= 1 + side * step
                    if turn == 2 and steps[2] < 0:
                        trial[4] *= 1 + side * step
                place_on_maps(points, directions, trial[2], trial[3], trial[4], pad, placed)
                value = sign * response_sum(maps, placed, int(trial[0]), int(trial[1]))
                if value > best:
                    best = value
                    candidates[c, :5] = trial
        values[c] = best / (PEAK * points.shape[0])


@kernel("i8(f8[:, ::1], i8, f8, i8[::1])")
def best_of_each_place(
    rows: Array,
    limit: int,
    apart_rad: float,
    kept: Array,
) -> int:
    """Fill kept with the rows (x, y, angle, ., ., sign), best first, that have no better one near; return
    their number."""
    number = 0
    for i in range(rows.shape[0]):
        hidden = False
        for k in range(number):
            j = kept[k]
            turn = abs((rows[i, 2] - rows[j, 2] + np.pi) % (2 * np.pi) - np.pi)
            near = abs(rows[i, 0] - rows[j, 0]) <= 4 and abs(rows[i, 1] - rows[j, 1]) <= 4
            if near and turn < apart_rad and rows[i, 5] == rows[j, 5]:
                hidden = True
                break
        if not hidden:
            kept[number] = i
            number += 1
            if number == limit:
                break
    return number


@kernel("void(f8[:, ::1], f8[::1], f8[:, ::1], i8, i8, i8, i8[:, ::1])")
def pose_offsets(
    points: Array, directions: Array, poses: Array, rows: int, columns: int, pad: int, offsets: Array
) -> None:
    """Write offsets (P, N) in the flat maps of each point of poses (P, 3): angle, scale x, scale y."""
    placed = np.empty((points.shape[0], 3), np.int64)
    for p in range(poses.shape[0]):
        place_on_maps(points, directions, poses[p, 0], poses[p, 1], poses[p, 2], pad, placed)
        for n in range(points.shape[0]):
            x, y, o = placed[n, 0], placed[n, 1], placed[n, 2]
            offsets[p, n] = (((o * 2 + (y & 1)) * 2 + (x & 1)) * rows + (y >> 1)) * columns + (x >> 1)
