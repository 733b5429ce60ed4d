"""Tuned parameters of the stages in this package, each with its source."""

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
    tolerance_px: float = 1.0  # largest distance of an edge from a trial plane that counts as agreeing
    rivals: int = 12  # most edges of a right row that are kept as partners of one left edge
    trials: int = 1500  # RANSAC trials (Fischler and Bolles 1981, doi:10.1145/358669.358692)
    depth_margin: float = 0.06
    """Half the depth range that is searched, as a share of the distance. The scale of a match gives the
    distance to 1 %; the rest allows for a tilt and a poor scale."""
    samples: int = 240  # points on all curves together
    reach_px: float = 4.0  # search range along their normals, to either side
    border_share: float = 0.06  # left out at both ends of an edge, where the corner's other edge is as near
    misfit_px: float = 2.0  # rms on the top level, after the best similarity, that a scan still tolerates
    misfit_share: float = 0.1  # rms over rms radius that the first steps correct: 0.07 is a tilt of 30°
    grid_step_rad: float = math.radians(5.0)  # spacing of the candidate views
    outline_points: int = 64  # points of the shape with which views are compared
    max_lean_rad: float = math.radians(65.0)  # to the left camera's line of sight: beyond it a face is a line
    ring_points: int = 24  # directions of tilt that are tried
    turn_margin_rad: float = math.radians(15.0)
    """Added to a view's range of turns: the line of sight varies over the picture, and a scan has steps."""


START = StartParams()


@dataclass(frozen=True, slots=True)
class MeasuringParams:
    """Circles, edges, heights and pose of a flat part, and the consistency tests between them.

    Where a line names no source, `tools/bench ablate --only MeasuringParams` shows what the number earns.
    """

    depth_margin: float = 0.05
    """Half the depth range that is searched, as a share of the distance. The scale of a match gives the
    distance to 1 %; the rest allows for a tilt and a poor scale."""
    outline_points: int = 240  # points on the reference circle
    outline_reach_px: float = 4.0  # search range along its normals, to either side
    place_tolerance: float = 0.02  # of the reference radius: a circle farther from its place is another edge
    place_margin_mm: float = 0.1  # added to it
    max_rivals: int = 12  # most turns that are tried of those that put one circle in another's place
    min_support: float = 0.15
    """Share of the reference circle that each camera must show for a start to count; a job asks for more."""
    enough_support: float = 0.8  # with this support in both cameras no better start is looked for
    short_arm: float = 0.15  # of the reference's radius: circles nearer to its centre tell no rotation
    pnp_points: int = 16  # points of a circle from which a start is computed
    other_end: float = 4.0  # sigmas beyond which a radius does not differ from the taught one by chance
    row_stretch: int = 8  # successive edge points whose row differences are averaged
    min_rows: int = 4  # fewest edge points whose row is defined
    lock: FitParams = FitParams(reach_px=(3.0, 2.5, 2.0, 2.0), repeats=0, min_support=0.0)
    """Fit of the reference circle with its taught radius, from a pose of the match."""
    wide_lock: FitParams = FitParams(reach_px=(6.0, 4.0, 2.5, 2.0), repeats=0, min_support=0.0)
    """Its fit from a plane found by the rows of both images, which may be far off."""
    other_lock: FitParams = FitParams(reach_px=(3.0, 2.0), repeats=0, min_support=0.4)
    """First fit of the other circles."""
    together: FitParams = FitParams(reach_px=(2.0,), min_support=0.0)  # final fit of all circles
    certain: float = 2.0
    """Sigmas up to which a deviation counts as chance; they include systematic shifts, seldom so large."""
    wall_px: float = 0.2  # row shift that is no contradiction, for a rig without a stated covariance
    min_rows_px: float = 0.05  # likewise for a rig that states its covariance
    along_per_across: float = 8.0
    """1 sigma of a camera's motion along the rows over its motion across them: 98 % of all directions are
    within four."""
    min_sizes: int = 3  # fewest sizes from which a common growth is computed
    min_size_share: float = 1e-6  # floor of a size's relative sigma: no machined part is more precise
    arm: float = 0.15  # of the reference radius: the distance of a circle farther away counts as a size
    identity: FitParams = FitParams(reach_px=(6.0, 4.0, 2.5, 2.0), repeats=0)
    """Fit of a missing circle at any height."""
    identity_support: float = 0.6  # support that it must have in each camera
    same: float = 0.1  # of its radius: how much it may differ in size and place
    identity_certain: float = 5.0  # sigmas of height that put it off the face: light and walls displace holes
    off_face_px: float = 1.0  # disparity off the face, half in each image: edges of one plane scatter by less
    sectors: int = 24  # sectors around a circle
    spokes: int = 15  # profiles in each sector: their mean averages texture out
    rival_reach: float = 0.1  # of the radius: an edge farther off is not mistaken for the reference
    min_reach_px: float = 6.0  # minimum length of a profile, to either side
    max_reach_px: float = 24.0  # maximum length
    step_px: float = 0.5  # sample spacing along the profiles
    own_px: float = 1.5  # a maximum nearer than this is the circle's own edge
    apart_px: float = 2.5  # from here on it is another edge; in between the two cannot be separated
    rival_slope: float = 0.4  # least slope of another edge, relative to the circle's own
    min_slope: float = 2.0  # grey values per px
    rival_share: float = 0.6
    """Share of the circle with a second edge, mean of both images; seen along a chamfer both edges merge."""
    min_rival_share: float = 0.35  # that share in each image: a wall or its shadow shows on one side only
    flatness_reach_mm: float = 1.0
    """Points farther from the plane belong to another surface: a recess, or the table seen through a hole."""
    flatness_grid_px: int = 12  # spacing of the points
    flatness_points: int = 20  # fewest points on the face
    flatness_rounds: int = 8  # iterations of reweighted fitting
    height_fit: FitParams = FitParams(reach_px=(3.0, 2.0), min_support=0.3)
    """Fit of a single circle whose height is measured."""
    solid_mm: float = 0.25  # features whose heights differ by less lie on one face
    depth_share: float = 0.12  # default depth limits of a job, +- this share of the taught distance
    displaced_px: float = 0.5
    """Displacement that makes it another edge. A change of light displaces edges by up to a third of this,
    walls by more (`systematic`)."""
    near: FitParams = FitParams(reach_px=(3.0, 2.0))  # fit of all curves from a good pose
    far: FitParams = FitParams(reach_px=(8.0, 5.0, 3.0, 2.0))
    """Fit of all curves from the pose of a match: a pixel of disparity is 1/500 of the depth and moves the
    edge in each image by half a pixel."""
    min_edges: int = 3  # two edges fit any two that lie alike in one image: only a third can contradict
    min_level: float = 0.7  # cosine between an edge and the rows above which its row is well defined
    across: float = 2.0  # sigma of a CAD model's edges perpendicular to the face, over that within it
    concentric: float = 0.15  # of the reference radius: a circle nearer to it does not define the rotation
    cloud_grid_px: int = 8  # spacing of face points
    cloud_margin_px: float = 12.0  # kept from edges: a window that touches one sees two surfaces
    cloud_min_weight: float = 0.3  # least weight of a contour point in its fit
    cloud_sigma_px: float = 0.1  # sigma of one edge point beside texture, for the sigma stated in the file
    taught_sigma_mm: float = 0.003
    """Sigma of a feature's taught position: the precision of one measurement of a machined edge."""
    pose_rounds: int = 8  # iterations of reweighting
    min_spare: int = 2  # observations beyond the unknowns needed to separate growth from a displaced feature
    clear: float = 0.5  # net share of the edges expected by this rotation alone above which no other is tried
    against: float = 0.05  # lead of another rotation in the right image that contradicts the match


MEASURING = MeasuringParams()


@dataclass(frozen=True, slots=True)
class SolidParams:
    """Thick and tilted parts: locking the whole model onto both images, and its tests.

    Debt: the shares below were tuned on cases of `tools/bench solid` and `tools/bench slices`. The single
    path for all machined parts, which decides by likelihoods, will replace this class and the code that
    reads it.

    Where a line names no source, `tools/bench ablate --only SolidParams` shows what the number earns.
    """

    rings: tuple[tuple[float, int], ...] = ((0.0, 1), (10.0, 6), (20.0, 10), (30.0, 14))
    """Leans in degrees, and the number of directions for each: a lock converges from 5° off."""
    depths: tuple[float, ...] = (0.0, 0.02, 0.04, 0.06, 0.09)
    """Shares added to the distance: a body's outline is larger than its face's, and seems nearer."""
    lean_margin_rad: float = math.radians(5.0)  # added to the job's tilt
    lean_reach_px: float = 12.0  # search range at a first glance
    likely: int = 10  # starts that are locked
    far_px: tuple[float, ...] = (16.0, 12.0, 8.0, 6.0)
    """Search range by step: a match knows its distance to one percent, which is ten px."""
    near_px: tuple[float, ...] = (4.0, 2.5, *(2.0,) * 10)
    """Search range by step; the last is repeated until the pose stands still."""
    lock_rival_px: tuple[float, ...] = (4.0, 3.0, 2.5)  # search range by step for a rival pose
    rival_lacks: float = 0.08  # a rival whose agreement is lower by more than this is not refined
    still_px: float = 0.1  # a smaller step ends the lock
    glance_px: float = 4.0  # search range of a first look at a rival
    far_spacing_px: float = 5.0  # sample spacing in far steps
    spacing_px: float = 2.5  # sample spacing in near steps
    hopeless: float = 0.25  # agreement in each camera below which a lock is given up after the far steps
    along_px: float = 10.0  # length of curve over which profiles are averaged: no texture edge is that long
    alike: float = 0.03  # relative change of image scale below which samples are reused
    margin_px: float = 5.0  # left out at both ends of an edge: beside a corner the other edge is as near
    odd_px: float = 2.0  # by how much an edge of the wrong sign must be nearer to be taken
    odd_share: float = 0.5  # its weight: light and walls invert some signs
    agree_px: float = 1.0  # distance within which an edge agrees with a pose
    min_sigma_px: float = 0.4  # floor of the robust scale in a lock
    tight_sigma_px: float = 0.6  # its ceiling in a second lock, which follows one of a broken rim's two edges
    tight_steps: int = 10  # most steps of the second lock
    good_share: float = 0.75  # agreement in both cameras at which no better pose is looked for
    max_step_rad: float = 0.2  # largest rotation in one step
    lock_rounds: int = 5  # iterations of reweighting in one step
    stretches: int = 48  # stretches of a curve, each with a sign of its own
    rival_px: float = 4.5  # a second edge nearer than this displaces the first one, whatever the operator
    reach_px: float = 8.0  # search range of the profiles, to either side
    min_shown: float = 0.5  # least visible share of a curve for it to count as missing if it is not found
    min_curves: int = 3  # fewest measured curves of a part
    enough: float = 0.4  # share of a curve without rivals at which the rest of it is not used
    like: float = 0.1  # relative difference in length up to which two edges may be mistaken for each other
    max_rivals: int = 16  # most rival motions that are tried
    aside: float = 0.2  # of the part's size: how far such a motion may shift the middle
    concentric: float = 0.15  # of its radius: a circle nearer to the axis of a turn looks the same after it
    same_turn_rad: float = math.radians(3.0)  # two poses that differ by less are one
    min_margin: float = 0.012  # of all curves: least lead of one turn over others; an odd hole is about 0.04
    min_share: float = 0.58  # of all curves: least mean agreement of both cameras; a wrong pose has 0.5
    min_camera_share: float = 0.4  # least agreement of each camera
    leant_share: float = 0.68
    """Least agreement of a pose far from the match: right ones have 0.69 and more, wrong ones 0.66."""
    rival_share: float = 0.25
    """A rival is tried if at a glance it agrees less than the best by no more than this: a few px off it
    still lacks some."""
    min_found: float = 0.5  # of the visible curves, and circles: with fewer it is another part, or covered
    plain_share: float = 0.65  # agreement of a curve that is plainly seen; by chance it is 0.5
    turns_rad: tuple[float, ...] = tuple(math.radians(15.0) * np.arange(1, 24))  # turns that are tried
    turn_reach_px: float = 12.0  # search range at a first glance at them
    turned_starts: int = 3  # the number of them that are locked
    poor_share: float = 0.35  # agreement of the worse camera below which no rival is tried: there is no pose
    fit: FitParams = FitParams(reach_px=(1.5,), min_support=0.15)  # fit of all curves from the locked pose
    known_fit: FitParams = FitParams(reach_px=(1.5,), min_support=0.08)
    """That fit where the part's surface is known, which tells which stretches are good."""
    alone_fit: FitParams = FitParams(reach_px=(2.0,), min_support=0.5)  # free fit of each curve for its size
    outline_points: int = 24  # points of a curve from which a start is computed
    rigid_px: float = 0.08
    """Sigma of a feature's taught place and size: how far another light and view moved its edges."""
    enough_clean: float = 0.2  # clean share of all curves in each camera at which nothing else is used
    saturated: int = 254  # grey value from which the true brightness is unknown
    glare_px: int = 3  # distance from a saturated surface within which an edge is displaced
    own_mm: float = 0.04  # a model edge nearer than this is the curve itself, drawn as chords
    together_px: float = 0.28
    """Distance of two edges up to which either may be measured: a sigma of 0.08 px, that of taught places."""
    line_px: float = 0.7  # spacing of the points that an edge of the model is drawn with
    size_px: int = 384  # side of the z-buffer: for a part that fills half an image, two camera px each
    around_px: int = 1  # a point this near to a surface that hides it counts as hidden
    behind_share: float = 0.015
    """Share of the body's size: a point less deep behind a surface lies on it; chords are as coarse."""
    behind_px: float = 3.5
    """Least such depth in pixels of the buffer: a face seen at 65° is deeper by 2.1 in the next pixel."""


SOLID = SolidParams()
