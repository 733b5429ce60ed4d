"""Assessment of a taught shape: distinctness of its rotation, contrast, attainable precision."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edged.domain.arrays import FloatArray
from edged.vision.shape.model import ShapeModel
from edged.vision.shape.params import LEARNING, SearchParams


@dataclass(frozen=True, slots=True, eq=False)
class ModelInspection:
    """Facts about a model.

    rivals (K, 2) : rotation in rad and similarity of the shape with itself there, most similar first.
    symmetric : the best rival cannot be distinguished; round : no rotation can.
    reserve : factor by which the contrast may fall before edges no longer count.
    sigma_x_px, sigma_y_px, sigma_angle_rad, sigma_scale : Cramer-Rao bound of the pose in one image with
    noise `LearningParams.noise`, from the model's edges; infinite for the rotation of a round shape.
    warnings : in plain words, worst first.  codes : one for each of them, for programs.
    """

    rivals: FloatArray
    symmetric: bool
    round: bool
    reserve: float
    sigma_x_px: float
    sigma_y_px: float
    sigma_angle_rad: float
    sigma_scale: float
    warnings: tuple[str, ...]
    codes: tuple[str, ...]


def inspect_model(model: ShapeModel, search: SearchParams) -> ModelInspection:
    """Judge a model for a search."""
    order = np.argsort(-model.symmetries[:, 3], kind="stable")
    rivals = model.symmetries[order][:, 2:4]
    symmetric = len(model.equal_motions) > 0
    sigmas = _bounds(model)
    reserve = model.contrast / max(search.min_contrast, 1e-9)
    worded = _warnings(model, rivals, symmetric, reserve, sigmas)
    return ModelInspection(
        rivals=rivals,
        symmetric=symmetric,
        round=model.round,
        reserve=reserve,
        sigma_x_px=sigmas[0],
        sigma_y_px=sigmas[1],
        sigma_angle_rad=np.inf if model.round else sigmas[2],
        sigma_scale=sigmas[3],
        warnings=tuple(text for _, text in worded),
        codes=tuple(code for code, _ in worded),
    )


def _bounds(model: ShapeModel) -> tuple[float, float, float, float]:
    """Sigmas of x, y, angle and scale from the edges' normals, each edge with the noise of its slope."""
    points, normals = model.levels[0].points, model.levels[0].normals
    turned = np.column_stack([-points[:, 1], points[:, 0]])
    jacobian = np.column_stack([normals, np.sum(normals * turned, axis=1), np.sum(normals * points, axis=1)])
    information = jacobian.T @ jacobian
    # the bound of an edge of blur s and slope g, per px of it, is sigma² / (sqrt(pi) s g²), here with s = 1;
    # neighbours share pixels, which is what `repetition` counts
    variance = (LEARNING.noise / model.contrast) ** 2 * model.repetition / np.sqrt(np.pi)
    values, vectors = np.linalg.eigh(information)
    with np.errstate(divide="ignore"):
        inverse = np.where(values > 1e-9 * values[-1], 1 / values, np.inf)
    spread = np.array([np.sum(np.where(row**2 > 1e-12, row**2 * inverse, 0.0)) for row in vectors])
    x, y, angle, scale = np.sqrt(variance * spread)
    return float(x), float(y), float(angle), float(scale)


def _warnings(
    model: ShapeModel,
    rivals: FloatArray,
    symmetric: bool,
    reserve: float,
    sigmas: tuple[float, float, float, float],
) -> list[tuple[str, str]]:
    """Code and text of each warning."""
    worded: list[tuple[str, str]] = []
    number = len(model.levels[0].points)
    if model.round:
        text = "The shape is round: it has no rotation. Results state one canonical angle."
        worded.append(("round", text))
    elif symmetric:
        angles = ", ".join(f"{np.degrees(angle):.0f}°" for angle, s in rivals if s >= model.same_score)
        text = f"The shape looks the same after a turn of {angles}: of these the nearest to 0 is given."
        worded.append(("symmetric", text))
    elif len(rivals) and rivals[0, 1] >= LEARNING.confusable:
        angle, similarity = rivals[0]
        text = (
            f"After a turn of {np.degrees(angle):.0f}° the shape is {100 * similarity:.0f} % similar: "
            "where the rest is hidden, results carry AMBIGUOUS_ROTATION. Light what makes the difference."
        )
        worded.append(("confusable", text))
    if reserve < LEARNING.weak_reserve:
        text = (
            f"Edges are only {reserve:.1f} times as strong as the weakest that counts: more light, or focus."
        )
        worded.append(("weak", text))
    if number < LEARNING.few_points:
        text = f"The model has only {number} edge points: a larger region, or a larger image of the part."
        worded.append(("few_points", text))
    if len(model.levels) < 3:
        text = f"The model has {len(model.levels)} pyramid level(s): a larger image would be searched faster."
        worded.append(("few_levels", text))
    worst, best = max(sigmas[:2]), min(sigmas[:2])
    if worst > LEARNING.lopsided * best:
        axis = "x" if sigmas[0] > sigmas[1] else "y"
        text = (
            f"Along {axis} the shape has few edges: its place there is {worst / best:.0f} times less certain."
        )
        worded.append(("lopsided", text))
    return worded
