"""Circles, straight edges and slots of one face, fitted in space to the raw edges of both cameras at once.

The paper fits an ellipse in each rectified image and triangulates its centre; but the image of a circle's
centre is not the centre of its ellipse (0.1-0.3 mm at 24° vergence). Here the unknowns are the plane and each
curve's own parameters in it. The curves are projected through lens and pose of each camera, edges are
measured across the projected curves, and their offsets along the normals are the residuals of one robust
least-squares problem. Nothing is rectified, no ellipse is formed, no point needs a partner in the other
image.

One solution for all curves gives what distances and angles between features need: their joint covariance, in
which the errors that they share, of the plane, of the light and of the calibration, cancel as they do in the
result. What both cameras say in common and what they say against each other are different witnesses (see
`commonmode`), each with a scatter and a correlation along the edge of its own. Half of the variance of the
systematic edge shifts is each curve's own, half is shared by the curves of one kind: five holes in one light
are not five independent witnesses (see `systematic`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from edged.domain import FloatArray, Image
from edged.vision.curves.curvefit import DEFAULT_PARAMS, FitParams, PlaneFit
from edged.vision.curves.outlineprojection import circle_axes
from edged.vision.curves.outlines import Curve, Face
from edged.vision.curves.planestate import State, Step
from edged.vision.geometry.camera import StereoRig

COARSE_SPACING_PX = 3.0  # while the curves still move
STILL_PX = 0.2  # edges measured anew at curves that moved by less come out the same, to 0.003 px


def fit_plane(
    rig: StereoRig,
    images: tuple[Image, Image],
    face: Face,
    curves: Sequence[Curve],
    params: FitParams = DEFAULT_PARAMS,
    *,
    fixed_normal: bool = False,
    fixed_radius: bool = False,
    rigid_mm: float | None = None,
) -> PlaneFit | None:
    """Measure curves of one plane together; None when the images show none, or too few to know the plane.

    images : left and right, raw (H, W) uint8.  face, curves : a start, as good as params.reach_px[0].
    fixed_normal : the plane's direction is known better from elsewhere (a small hole in a large face).
    fixed_radius : circles keep theirs; rivals beside a rim then do not fit.
    rigid_mm : the curves are those of one part, its places and sizes known to this sigma; it moves, turns and
    grows as a whole. None: each curve lies where it will.
    """
    return _fitted(State(rig, images, face, tuple(curves), params, fixed_normal, fixed_radius, rigid_mm))


def fit_circle(
    rig: StereoRig,
    images: tuple[Image, Image],
    centre_mm: FloatArray,
    normal: FloatArray,
    radius_mm: float,
    polarity: int = 0,
    params: FitParams = DEFAULT_PARAMS,
    *,
    name: str = "circle",
    fixed_normal: bool = False,
    fixed_radius: bool = False,
) -> PlaneFit | None:
    """Measure one circle near a first guess; the rest as `fit_plane`.

    centre_mm, normal (3,) : rig frame; the normal points towards the cameras.
    polarity : +1 brighter outside, -1 darker outside, 0 whichever most of its edge shows.
    """
    face = Face(np.asarray(centre_mm, np.float64), np.vstack([circle_axes(-normal), -normal]))
    circle = Curve(name, "circle", np.array([0.0, 0.0, radius_mm]), polarity)
    return fit_plane(
        rig, images, face, [circle], params, fixed_normal=fixed_normal, fixed_radius=fixed_radius
    )


def _fitted(start: State) -> PlaneFit | None:
    """Lay the curves where they are, then measure them."""
    params = start.params
    state: State | None = start
    step: Step | None = None
    spacing_px = max(params.spacing_px, COARSE_SPACING_PX)
    for number, reach in enumerate(params.reach_px[:-1] if params.repeats else params.reach_px):
        if number == 1 and state is not None:
            # far away there is one dominant edge; from here on each curve keeps its sign
            state = state.with_polarity(reach, spacing_px)
        step = None if state is None else state.step(reach, spacing_px, final=False)
        state = None if state is None or step is None else state.moved(step)
        if number > 0 and step is not None and step.moved_px.max() < STILL_PX:
            break
    if state is None:
        return None
    if params.repeats:
        state = state.with_polarity(params.reach_px[-1], params.spacing_px)
    left = params.repeats
    while left:
        step = state.step(params.reach_px[-1], params.spacing_px, final=True)
        kept = [] if step is None else step.supported(params.min_support)
        if step is None or not kept:
            return None
        if params.min_support and len(kept) < len(state.curves):  # what is not there must not pull the others
            state = replace(state, curves=tuple(state.curves[k] for k in kept))
            continue
        left -= 1
        moved = state.moved(step)
        if moved is None:
            return None
        state = moved
        if step.moved_px.max() < STILL_PX:
            break
    return None if step is None else state.result(step)
