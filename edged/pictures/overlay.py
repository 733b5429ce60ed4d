"""Pictures for people: a stereo pair with what was measured in it, what was not, and why not."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from edged.domain.arrays import SIDES, FloatArray, Image
from edged.domain.measurement import NearMiss, NotMeasured, Status, Target
from edged.domain.numerals import is_whole
from edged.pictures.captions import feature_lines, headline, pose_lines, reasons, reference_name, size_lines
from edged.pictures.evidence import (
    GOLD,
    GREEN,
    GREY,
    MAGENTA,
    RED,
    WHITE,
    FeatureEvidence,
    Residuals,
    draw_feature,
    draw_missed,
    draw_missing,
    draw_name,
    draw_number,
    draw_pose,
    draw_unrolled,
    features_of,
    keep_free,
    magnification,
    missing_outlines,
    residuals,
)
from edged.pictures.lettering import BOLD, NORMAL, Canvas, Colour, shortened, width_of, write, write_rimmed
from edged.pictures.view import PictureView, box_around, view_of, zoom_for
from edged.vision.geometry.camera import StereoRig
from edged.vision.part.job import Job
from edged.vision.part.measured import MeasuredPart

WIDTH_PX = 1280
"""Width of either image in the picture, so that text has the same size on all pictures."""
PAPER: Colour = (34, 30, 28)
BADGES: dict[Status, tuple[str, Colour]] = {
    Status.OK: ("OK", (60, 150, 40)),
    Status.LOW_QUALITY: ("NOK", (50, 50, 215)),
    Status.NO_TARGET: ("NO TARGET", (120, 110, 100)),
    Status.CAPTURE_FAULT: ("CAPTURE FAULT", (50, 50, 215)),
}
TITLE_PX, TEXT_PX, LINE_PX, MARGIN_PX = 32, 22, 31, 28
TITLE_HEIGHT_PX, LEGEND_HEIGHT_PX, COLUMN_PX = 72, 44, 530
MAX_BLOCKS, MAX_FEATURES = 6, 9
"""Parts, and features of a part, that are listed; the number of further ones is stated."""
AXES_SHARE = 0.4
"""Length of the part's axes over the distance to its farthest feature point."""


def draw_pair(
    left: Image,
    right: Image,
    rig: StereoRig,
    job: Job,
    measured: Sequence[MeasuredPart],
    dismissed: Sequence[NotMeasured] = (),
    status: Status = Status.OK,
    nearest: NearMiss | None = None,
) -> Canvas:
    """Draw a title, both images with the evidence, and the figures of each part; (H, 2 * WIDTH_PX, 3) BGR.

    Good parts come first and have the lower numbers. Fitted curves are green, that of the reference gold.
    Across them, edge minus curve is drawn in magenta, magnified by a factor stated in the legend; edges that
    do not agree are red, at their actual places. Features that were not measured are dashed. For a single
    part the reference's residuals are also shown as a chart.
    """
    parts = sorted(measured, key=lambda part: (bool(part.target.reject), -part.target.match.score))
    features = [features_of(part) for part in parts]
    outlines = [feature.outline_mm for some in features for feature in some]
    outlines += [outline for part in parts for outline in missing_outlines(job, part.target).values()]
    views = _views((left, right), rig, outlines, dismissed)
    found = [
        [[residuals(view, feature, side) for feature in some] for some in features]
        for side, view in enumerate(views)
    ]
    factor = magnification([residual for side in found for some in side for residual in some], views[0].scale)
    _draw_parts(views, job, parts, features, found, factor)
    for number, missed in enumerate(dismissed, len(parts) + 1):
        place = np.array([missed.match.x_px, missed.match.y_px])
        draw_missed(views[0], place)
        draw_number(views[0], number, views[0].place(place)[None] - 30, RED)
    blocks = [_part_block(number, job, part) for number, part in enumerate(parts, 1)]
    blocks += [_missed_block(number, missed) for number, missed in enumerate(dismissed, len(parts) + 1)]
    if len(blocks) == 1 and any(features):
        chart = _paper(blocks[0].shape[0], WIDTH_PX)
        chosen = next((k for k, feature in enumerate(features[0]) if feature.is_reference), 0)
        draw_unrolled(chart, features[0][chosen], [side[0][chosen] for side in found])
        blocks.append(chart)
    if nearest is not None:
        draw_missed(views[0], np.array([nearest.match.x_px, nearest.match.y_px]))
    words = headline(job, parts, dismissed, nearest)
    title = _title(words, status, factor if any(features) else None, views[0].scale)
    return np.vstack([title, _side_by_side(views), _in_rows(blocks)])


def _views(
    images: tuple[Image, Image],
    rig: StereoRig,
    outlines_mm: Sequence[FloatArray],
    dismissed: Sequence[NotMeasured],
) -> tuple[PictureView, PictureView]:
    """Views of both pictures, cropped to the parts if these are small.

    Not cropped if a match was not measured, as its place in the right picture is unknown.
    """
    sides = list(zip(images, (rig.left, rig.right), (np.eye(4), rig.right_from_left), strict=True))
    sizes = [(image.shape[1], image.shape[0]) for image in images]
    whole = [view_of(*side, (0, 0, *size), WIDTH_PX) for side, size in zip(sides, sizes, strict=True)]
    if dismissed or not outlines_mm:
        return whole[0], whole[1]
    extents = [view.raw(np.concatenate(outlines_mm)) for view in whole]
    zoom = zoom_for(sizes, extents)
    boxes = [box_around(size, extent, zoom) for size, extent in zip(sizes, extents, strict=True)]
    left, right = (view_of(*side, box, WIDTH_PX) for side, box in zip(sides, boxes, strict=True))
    return left, right


def _side_by_side(views: tuple[PictureView, PictureView]) -> Canvas:
    """Both canvases side by side, labelled with the cameras' names."""
    for view, name in zip(views, SIDES, strict=True):
        words = f"{name} image" if view.scale == 1 else f"{name} image, magnified {view.scale:.2g}×"
        write_rimmed(view.canvas, words, (MARGIN_PX, view.canvas.shape[0] - 18), WHITE, TEXT_PX)
    height = max(view.canvas.shape[0] for view in views)
    images = np.hstack([_filled(view.canvas, height) for view in views])
    cv2.line(images, (WIDTH_PX, 0), (WIDTH_PX, height), PAPER, 3)
    return images


def _draw_parts(
    views: tuple[PictureView, PictureView],
    job: Job,
    parts: Sequence[MeasuredPart],
    features: Sequence[Sequence[FeatureEvidence]],
    found: Sequence[Sequence[Sequence[Residuals]]],
    factor: float,
) -> None:
    """Draw all evidence, then all labels. found : residuals by side, part and feature."""
    for view, of_parts in zip(views, found, strict=True):
        for some, of_part in zip(features, of_parts, strict=True):
            for feature, residual in zip(some, of_part, strict=True):
                draw_feature(view, feature, residual, factor)
        for number, (part, some) in enumerate(zip(parts, features, strict=True), 1):
            _draw_names(view, job, part.target, some, number if len(parts) > 1 else None)


def _draw_names(
    view: PictureView, job: Job, target: Target, features: Sequence[FeatureEvidence], number: int | None
) -> None:
    """Draw pose, number and feature names of one part."""
    missing = missing_outlines(job, target)
    outlines = [view.place(view.raw(feature.outline_mm)) for feature in features]
    dashed = [draw_missing(view, outline) for outline in missing.values()]
    every = np.concatenate(
        [target.position_mm[None], *(feature.outline_mm for feature in features), *missing.values()]
    )
    reach_mm = float(np.linalg.norm(every - target.position_mm, axis=1).max())
    for line in (*outlines, *dashed):
        keep_free(view, line)
    draw_pose(view, target, AXES_SHARE * max(reach_mm, 1.0), RED if target.reject else GOLD)
    seen = view.place(view.raw(every))
    if number is not None:
        draw_number(view, number, seen, RED if target.reject else BADGES[Status.OK][1])
    middle = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    for feature, outline in sorted(
        zip(features, outlines, strict=True), key=lambda pair: float(np.ptp(pair[1], axis=0).max())
    ):
        name = f"{feature.name} (reference)" if feature.is_reference else feature.name
        draw_name(view, name, outline, GOLD if feature.is_reference else WHITE, middle)
    for name, line in zip(missing, dashed, strict=True):
        draw_name(view, name, line, GREY, middle)
    for corner in target.corners:
        draw_name(view, corner.name, view.place(view.raw(corner.position_mm[None])), WHITE, middle)


def _title(text: str, status: Status, factor: float | None, scale: float) -> Canvas:
    """Title with the verdict and, if anything was measured, the legend beside it or below.

    factor, scale : residuals are magnified by `factor`, on images scaled by `scale`.
    """
    canvas = _paper(TITLE_HEIGHT_PX)
    badge, colour = BADGES[status]
    width = width_of(badge, TITLE_PX, BOLD) + 2 * MARGIN_PX
    cv2.rectangle(canvas, (0, 0), (width, TITLE_HEIGHT_PX), colour, -1)
    write(canvas, badge, (MARGIN_PX, 47), WHITE, TITLE_PX, BOLD)
    write(canvas, text, (width + MARGIN_PX, 47), WHITE, TITLE_PX)
    if factor is None:
        return canvas
    legend = _legend(factor, scale)
    free = canvas.shape[1] - legend.shape[1]
    if width + width_of(text, TITLE_PX) + 2 * MARGIN_PX > free:
        return np.vstack([canvas, np.hstack([_paper(LEGEND_HEIGHT_PX, free), legend])])
    top = (TITLE_HEIGHT_PX - LEGEND_HEIGHT_PX) // 2
    canvas[top : top + LEGEND_HEIGHT_PX, free:] = legend
    return canvas


def _legend(factor: float, scale: float) -> Canvas:
    """Legend of the colours, with a scale bar for the residuals."""
    lengths = [step * decade for decade in (0.001, 0.01, 0.1, 1.0) for step in (1, 2, 5)]
    bar_px = max(length for length in lengths if length * factor * scale <= 40)
    entries = [
        ("reference", GOLD, 28),
        ("fitted", GREEN, 28),
        ("not measured", WHITE, -28),
        (f"{bar_px:g} px, edge minus fit (magnified {factor:g}×)", MAGENTA, round(bar_px * factor * scale)),
        ("edge of weight < 0.1", RED, 8),
    ]
    canvas = _paper(LEGEND_HEIGHT_PX)
    x = 0
    for words, colour, length in entries:
        if colour == RED:
            cv2.circle(canvas, (x + 4, 22), 4, colour, -1, cv2.LINE_AA)
        elif length > 0:
            cv2.line(canvas, (x, 22), (x + length, 22), colour, 3, cv2.LINE_AA)
        else:
            for dash in range(x, x - length, 12):
                cv2.line(canvas, (dash, 22), (dash + 5, 22), colour, 1, cv2.LINE_AA)
        x += abs(length) + 12
        x += _put(canvas, words, x, 30, GREY) + MARGIN_PX
    return canvas[:, :x]


def _in_rows(blocks: Sequence[Canvas]) -> Canvas:
    """Blocks below the images, two in a row; the number of those left out is stated."""
    rows = []
    for start in range(0, min(len(blocks), MAX_BLOCKS), 2):
        pair = blocks[start : start + 2]
        height = max(block.shape[0] for block in pair)
        filled = [_filled(block, height) for block in pair]
        rows.append(np.hstack([*filled, *[_paper(height, WIDTH_PX)] * (2 - len(pair))]))
    if len(blocks) > MAX_BLOCKS:
        more = _paper(LINE_PX + 12)
        write(more, f"and {len(blocks) - MAX_BLOCKS} more", (MARGIN_PX, LINE_PX - 4), GREY, TEXT_PX)
        rows.append(more)
    return np.vstack(rows) if rows else _paper(0)


def _part_block(number: int, job: Job, part: MeasuredPart) -> Canvas:
    """Block of one part: verdict and reasons, pose, features, and the job's measurements."""
    target = part.target
    why = reasons(target.reject)
    head = _paper(LINE_PX + 10, WIDTH_PX)
    x = MARGIN_PX + _put(head, f"{number}", MARGIN_PX, LINE_PX, WHITE, BOLD) + 16
    x += _put(head, f"{target.job}, score {target.match.score:.2f}", x, LINE_PX, WHITE, BOLD) + 20
    _put(head, "NOK" if why else "OK", x, LINE_PX, RED if why else GREEN, BOLD)
    rows = [_row((words, MARGIN_PX, RED)) for words in why]
    pose = [_row(("in the frame of the rig", MARGIN_PX, GREY), width=COLUMN_PX)]
    for name, value, sigma in pose_lines(target):
        spread = f"± {sigma}" if is_whole(sigma[0]) else sigma
        end = MARGIN_PX + 190 - width_of(value, TEXT_PX)
        pose.append(
            _row(
                (name, MARGIN_PX, GREY),
                (value, end, WHITE),
                (spread, MARGIN_PX + 200, WHITE),
                width=COLUMN_PX,
            )
        )
    plain, judged = _size_rows(target)
    pose += plain
    features = _feature_rows(job, part)
    height = LINE_PX * max(len(pose), len(features))
    both = [_filled(np.vstack(column), height) for column in (pose, features)]
    return np.vstack([head, *rows, np.hstack(both), *judged, _paper(18, WIDTH_PX)])


def _feature_rows(job: Job, part: MeasuredPart) -> list[Canvas]:
    """Rows of the table of the part's features."""
    lines = feature_lines(job, part)
    reference = reference_name(part.target)
    columns = 0, 150, 440, 550

    def row(words: Sequence[str], colour: Colour) -> Canvas:
        entries = [(word, x, colour) for word, x in zip(words, columns, strict=True)]
        entries[0] = (shortened(words[0], columns[1] - 12, TEXT_PX), *entries[0][1:])
        return _row(*entries, width=WIDTH_PX - COLUMN_PX)

    rows = [row(("feature", "size", "rms px", "seen left, right"), GREY)]
    for line in lines[:MAX_FEATURES]:
        colour = GOLD if line.name == reference else WHITE if line.seen else GREY
        rows.append(row((line.name, line.size, line.rms_px, line.seen), colour))
    if len(lines) > MAX_FEATURES:
        rows.append(row((f"and {len(lines) - MAX_FEATURES} more", "", "", ""), GREY))
    return rows


def _size_rows(target: Target) -> tuple[list[Canvas], list[Canvas]]:
    """Rows of the job's measurements: narrow ones for those without a tolerance, others with a verdict."""
    plain, judged = [], []
    for whole, text, ok in size_lines(target.measurements):
        name = shortened(whole, 180, TEXT_PX)
        if ok is None:
            x = MARGIN_PX + 20 + width_of(name, TEXT_PX)
            plain.append(_row((name, MARGIN_PX, GREY), (text, x, WHITE), width=COLUMN_PX))
        else:
            x = MARGIN_PX + 200
            verdict, colour = ("OK", GREEN) if ok else ("NOK", RED)
            after = x + width_of(text, TEXT_PX) + 20
            judged.append(_row((name, MARGIN_PX, GREY), (text, x, WHITE), (verdict, after, colour)))
    return plain, judged


def _row(*entries: tuple[str, int, Colour], width: int = WIDTH_PX) -> Canvas:
    """One line of a table. entries : text, x of its start, and colour."""
    canvas = _paper(LINE_PX, width)
    for words, x, colour in entries:
        _put(canvas, words, x, LINE_PX - 8, colour)
    return canvas


def _missed_block(number: int, missed: NotMeasured) -> Canvas:
    """Block of a match that could not be measured."""
    canvas = _paper(2 * LINE_PX + 16, WIDTH_PX)
    x = MARGIN_PX + _put(canvas, f"{number}", MARGIN_PX, LINE_PX, WHITE, BOLD) + 16
    text = f"score {missed.match.score:.2f}, not measured: {', '.join(reasons(missed.reject))}"
    _put(canvas, text, x, LINE_PX, RED, BOLD)
    return canvas


def _put(canvas: Canvas, text: str, x: int, y: int, colour: Colour, weight: int = NORMAL) -> int:
    """Write text; returns its width."""
    write(canvas, text, (x, y), colour, TEXT_PX, weight)
    return width_of(text, TEXT_PX, weight)


def _paper(height: int, width: int = 2 * WIDTH_PX) -> Canvas:
    return np.full((height, width, 3), PAPER, np.uint8)


def _filled(canvas: Canvas, height: int) -> Canvas:
    """The canvas extended with background to this height."""
    return np.vstack([canvas, _paper(height - canvas.shape[0], canvas.shape[1])])
