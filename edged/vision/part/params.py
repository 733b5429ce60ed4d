"""The tuned numbers of the stages in this package, each with its source."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edged.vision.curves.params import FitParams


@dataclass(frozen=True, slots=True)
class StartParams:
    """The first plane and pose of a part from one match, and how its face may be tilted.

    Where a line names no source, `tools/bench ablate --only StartParams` shows what the number earns.
    """

    max_slope: float = 0.25
    """Gradient of the disparity over the image, px per px: tilts up to about 25° at Z / baseline = 2."""
    min_along_row: float = 0.45  # cosine between row and normal; below it an edge's column is vague
    tolerance_px: float = 1.0  # between an edge and the plane that a trial proposes
    rivals: int = 12  # edges along a row that may be the left one's
    trials: int = 1500  # of RANSAC (Fischler and Bolles 1981, doi:10.1145/358669.358692)
    depth_margin: float = 0.06
    """Share of the distance. The match's size tells it to 1 %; a tilt and a bad scale are allowed for."""
    samples: int = 240  # of an outline
    reach_px: float = 4.0  # along its normals
    border_share: float = 0.06  # of an edge at both ends, where the corner's other edge is as near
    misfit_px: float = 2.0  # rms after the best similarity on the top level, which a scan's threshold bridges
    misfit_share: float = 0.1  # of the rms radius, which the first steps bridge: 0.07 is a tilt of 30°
    grid_step_rad: float = math.radians(5.0)  # between views
    outline_points: int = 64  # of a part whose views are compared
    max_lean_rad: float = math.radians(65.0)  # to the left camera's line of sight: beyond it a face is a line
    ring_points: int = 24  # directions of a tilt
    turn_margin_rad: float = math.radians(15.0)
    """The line of sight turns with the place in the picture; a scan has steps."""


START = StartParams()


@dataclass(frozen=True, slots=True)
class MeasuringParams:
    """A flat part's circles, edges, heights, pose and their tests against each other.

    Where a line names no source, `tools/bench ablate --only MeasuringParams` shows what the number earns.
    """

    depth_margin: float = 0.05
    """Share of the distance. The match's size tells it to 1 %; a tilt and a bad scale are allowed for."""
    outline_points: int = 240  # of the reference circle
    outline_reach_px: float = 4.0  # along its normals
    place_tolerance: float = 0.02  # of the part's size: a feature farther from its place is another edge
    place_margin_mm: float = 0.1  # added to it
    max_rivals: int = 12  # starts of the reference circle
    min_support: float = 0.15
    """Share of the reference circle that each camera must show at all; the job asks for more."""
    enough_support: float = 0.8  # in both cameras: no better start is looked for
    pnp_points: int = 16  # of a circle that gives a start
    other_end: float = 4.0  # sigmas of a radius by which it differs from the taught one not by chance
    row_stretch: int = 8  # edge points whose row differences are averaged
    min_rows: int = 4  # of these means
    lock: FitParams = FitParams(reach_px=(3.0, 2.5, 2.0, 2.0), repeats=0, min_support=0.0)
    """How the reference circle is laid."""
    wide_lock: FitParams = FitParams(reach_px=(6.0, 4.0, 2.5, 2.0), repeats=0, min_support=0.0)
    """How it is laid from far off."""
    other_lock: FitParams = FitParams(reach_px=(3.0, 2.0), repeats=0, min_support=0.4)
    """How other circles are laid."""
    together: FitParams = FitParams(reach_px=(2.0,), min_support=0.0)  # how all are measured
    certain: float = 2.0
    """Sigmas that chance may explain; they contain systematic shifts, which are seldom so large."""
    wall_px: float = 0.2  # distance of rows that says nothing, of a rig of unknown calibration
    min_rows_px: float = 0.05  # of a rig that states its own
    along_per_across: float = 8.0
    """1 sigma of a camera's motion along the rows over that across: 98 % of all directions are within
    four."""
    min_sizes: int = 3  # of a part whose sizes are compared
    min_size_share: float = 1e-6  # of a size: no machined part keeps more
    arm: float = 0.15  # of the reference radius, from which the place of a circle is a size
    identity: FitParams = FitParams(reach_px=(6.0, 4.0, 2.5, 2.0), repeats=0)
    """How a circle's other edge is laid."""
    identity_support: float = 0.6  # of that edge
    same: float = 0.1  # of its radius by which a circle may differ in size and place
    identity_certain: float = 5.0  # sigmas of its height: single holes are displaced by light and walls
    off_face_px: float = 1.0  # of disparity: half in each image, by which edges of one plane scatter
    sectors: int = 24  # around a circle
    spokes: int = 15  # profiles in each: their mean has no texture
    rival_reach: float = 0.1  # of the radius: no farther edge is taken for the reference
    min_reach_px: float = 6.0  # of the profiles, at least
    max_reach_px: float = 24.0  # at most
    step_px: float = 0.5  # of the profiles
    own_px: float = 1.5  # nearer it is the edge itself
    apart_px: float = 2.5  # from here on another one, and between them both are one
    rival_slope: float = 0.4  # of another edge over the circle's own
    min_slope: float = 2.0  # grey values per px
    rival_share: float = 0.6
    """Share of the circle, in the mean of both images: looking along a chamfer both edges are one."""
    min_rival_share: float = 0.35  # in each: a wall or its shadow is seen on one side only
    flatness_reach_mm: float = 1.0
    """Points farther from the plane are another surface: a recess, the table through a hole."""
    flatness_grid_px: int = 12  # of the points
    flatness_points: int = 20  # on the face
    flatness_rounds: int = 8  # of fit and choice
    height_fit: FitParams = FitParams(reach_px=(3.0, 2.0), min_support=0.3)
    """How circles off the face are laid."""
    solid_mm: float = 0.25  # features whose heights differ by less are those of one face
    depth_share: float = 0.12  # default depth limits of a job, of the taught distance
    displaced_px: float = 0.5
    """Another light displaces a part's edges by up to a third of this, walls by more (`systematic`)."""
    near: FitParams = FitParams(reach_px=(3.0, 2.0))  # how curves are measured from a good pose
    far: FitParams = FitParams(reach_px=(8.0, 5.0, 3.0, 2.0))
    """From a match's pose: a pixel of disparity is 1/500 of the depth and moves both edges by half as
    much."""
    min_edges: int = 3  # two edges fit any two that lie so in one image: only a third one contradicts
    min_level: float = 0.7  # cosine from which an edge has a row of its own
    across: float = 2.0  # sigma of a model's edges across the face over that in it
    concentric: float = 0.15  # of the reference radius within which a circle says nothing about the rotation
    cloud_grid_px: int = 8  # of the points of a face
    cloud_margin_px: float = 12.0  # a window that touches an edge of the part sees two surfaces
    cloud_min_weight: float = 0.3  # of a contour point
    cloud_sigma_px: float = 0.1  # of one edge point beside texture; for the sigma stated in the file
    taught_sigma_mm: float = 0.003
    """Sigma of a feature's taught place: the precision of one measurement of a machined edge."""
    pose_rounds: int = 8  # of reweighting
    min_spare: int = 2  # observations beyond the unknowns, before growth is told from a displaced feature
    clear: float = 0.5  # lead in edges expected of one rotation alone, at which no other is tried
    against: float = 0.05  # lead of another rotation in the right image


MEASURING = MeasuringParams()


@dataclass(frozen=True, slots=True)
class SolidParams:
    """Thick and tilted parts: the lock of the whole model onto both images, and its tests.

    Debt: the shares below were set between cases of `tools/bench solid` and `tools/bench slices`. The one
    path for all machined parts, which decides by likelihoods, replaces this class with the code that reads
    it.

    Where a line names no source, `tools/bench ablate --only SolidParams` shows what the number earns.
    """

    rings: tuple[tuple[float, int], ...] = ((0.0, 1), (10.0, 6), (20.0, 10), (30.0, 14))
    """Leans in°rees, and to how many sides: a lock comes from 5°."""
    depths: tuple[float, ...] = (0.0, 0.02, 0.04, 0.06, 0.09)
    """Shares of the distance: a body's outline is larger than its face's, and seems nearer."""
    lean_margin_rad: float = math.radians(5.0)  # added to the job's tilt
    lean_reach_px: float = 12.0  # of the first step
    likely: int = 10  # starts that are laid
    far_px: tuple[float, ...] = (16.0, 12.0, 8.0, 6.0)
    """Reach by step: a match knows its distance to one percent, which is ten px."""
    near_px: tuple[float, ...] = (4.0, 2.5, *(2.0,) * 10)
    """Reach by step; the last is repeated until the pose stands still."""
    lock_rival_px: tuple[float, ...] = (4.0, 3.0, 2.5)  # reach by step of a rival's lock
    rival_lacks: float = 0.08  # of agreement, by which a rival may lack without being laid better
    still_px: float = 0.1  # a smaller step ends the lock
    glance_px: float = 4.0  # reach of a first look at a rival
    far_spacing_px: float = 5.0  # of the samples in far steps
    spacing_px: float = 2.5  # of the samples
    hopeless: float = 0.25  # share of the curves that either camera must agree with after the far steps
    along_px: float = 10.0  # of a curve whose profiles are averaged: no texture has an edge that long
    alike: float = 0.03  # of two sizes in the picture: samples stay for smaller changes
    margin_px: float = 5.0  # of an edge at both ends: beside a corner the other edge is as near
    odd_px: float = 2.0  # by which an edge of the wrong sign must be nearer to be taken
    odd_share: float = 0.5  # its weight: light and walls turn some signs
    agree_px: float = 1.0  # between an edge and a pose that it agrees with
    min_sigma_px: float = 0.4  # of the robust scale in a lock
    tight_sigma_px: float = 0.6  # scale of a second lock that goes with one of two edges of a broken rim
    tight_steps: int = 10  # its steps
    good_share: float = 0.75  # agreement in both cameras at which no better pose is looked for
    max_step_rad: float = 0.2  # of the pose
    lock_rounds: int = 5  # of reweighting in one step
    stretches: int = 48  # of a curve, each with a sign of its own
    rival_px: float = 4.5  # a nearer second edge displaces the first one, whatever the operator
    reach_px: float = 8.0  # of the profiles
    min_shown: float = 0.5  # minimum visible share of a curve to count as missing
    min_curves: int = 3  # visible ones of a part
    enough: float = 0.4  # share of a curve without rivals, at which the rest is not needed
    like: float = 0.1  # relative difference in length of two edges that may be taken for each other
    max_rivals: int = 16  # turns and mirror poses
    aside: float = 0.2  # of the part's size: maximum shift of the centre by a turn
    concentric: float = 0.15  # of its radius: a circle nearer to the axis of a turn looks the same after it
    same_turn_rad: float = math.radians(3.0)  # between two turns that are one
    min_margin: float = 0.012  # of all curves, by which one turn must agree better: an odd hole is about 0.04
    min_share: float = 0.58  # of all curves that the cameras agree with in the mean: 0.5 at a wrong pose
    min_camera_share: float = 0.4  # that each agrees with
    leant_share: float = 0.68
    """Share of the curves at a pose far from the match: right ones have 0.69 and more, wrong ones 0.66."""
    rival_share: float = 0.25
    """Lack at first sight up to which another turn is tried: a few px off it lacks some."""
    min_found: float = 0.5  # of all curves, and of the circles: with fewer it is another part or hidden
    plain_share: float = 0.65  # of a curve that is plainly seen; by chance it is 0.5
    turns_rad: tuple[float, ...] = tuple(math.radians(15.0) * np.arange(1, 24))  # that are tried
    turn_reach_px: float = 12.0  # of their first step
    turned_starts: int = 3  # of them that are laid
    poor_share: float = 0.35  # with less no other turn is tried
    fit: FitParams = FitParams(reach_px=(1.5,), min_support=0.15)  # how the laid part's curves are measured
    known_fit: FitParams = FitParams(reach_px=(1.5,), min_support=0.08)
    """How they are measured where a surface tells which stretches are good."""
    alone_fit: FitParams = FitParams(reach_px=(2.0,), min_support=0.5)  # of each curve for its own size
    outline_points: int = 24  # of a curve
    rigid_px: float = 0.08
    """Sigma of a feature's taught place and size: another light and view moved its edges so far."""
    enough_clean: float = 0.2  # of all curves in each camera: then nothing else is used
    saturated: int = 254  # grey value from which a surface may be any brighter
    glare_px: int = 3  # around it an edge is displaced
    own_mm: float = 0.04  # nearer an edge of the model is the curve itself, drawn as chords
    together_px: float = 0.28
    """Between two edges either of which will do: a sigma of 0.08 px, what taught places are worth."""
    line_px: float = 0.7  # between the points that an edge of the model is drawn with
    size_px: int = 384  # of the buffer: for a part that fills half an image, two of the camera's
    around_px: int = 1  # a point this near to what hides it counts as hidden
    behind_share: float = 0.015
    """Share of the body's size: what lies less deep behind a surface is on it; chords are as coarse."""
    behind_px: float = 3.5
    """That depth in pixels of the buffer: a face seen at 65 degrees is deeper by 2.1 in the next pixel."""


SOLID = SolidParams()
