"""An L-shaped plate with a pad: its STEP file, and the same part for the renderer."""

from __future__ import annotations

from pathlib import Path

from edged.commands.teach import read_model
from edged.domain.arrays import FloatArray, Image
from edged.pipeline import prepare
from edged.sim.render.scene import Disc, Hole, PolygonShape, Surface
from edged.vision.geometry.rectification import StereoImages
from edged.vision.part.job import Job
from edged.vision.teaching.cadsettling import Settled, settle
from helpers.cells import small_rig
from helpers.tilted import lying

STEP = Path(__file__).parents[1] / "data" / "cad" / "D3.step"
PAD_MM = 2.5
CORNER = Hole("corner", Disc(-9, -7, 1.9))
HOLES = (Hole("h0", Disc(10, -7, 2.1)), Hole("h1", Disc(3, -7, 1.4)), Hole("h2", Disc(-9, 8, 2.1)),
         Hole("h3", Disc(-9, 1.8, 1.0)))  # fmt: skip
OUTLINE = PolygonShape(
    ((-14.5, -12.5), (14.5, -12.5), (14.5, -1.5), (-3.5, -1.5), (-3.5, 12.5), (-14.5, 12.5))
)
PAD = PolygonShape(((-13, -11), (-5, -11), (-5, -3), (-13, -3)))
DARK = Surface(albedo=0.2, contrast=0.1, feature_mm=0.5, seed=3)


def square() -> FloatArray:
    """rig_from_model of the part as it is taught."""
    return lying(small_rig(), 0.0, 0.0, 0.0)


def settled(job: Job, pair: tuple[Image, Image]) -> Settled:
    """The job with the model file, fitted to the pair that taught it."""
    images = StereoImages.of(prepare(small_rig()).rectification, *pair)
    return settle(job, read_model(STEP, "-z")[1].curves, images, "D3.step")
