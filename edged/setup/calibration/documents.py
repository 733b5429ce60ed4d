"""A draft of a calibration as it is told: over /api/v1, and to every open page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ConfigDict, JsonValue

from edged.adapters.web.gate import code_of
from edged.domain.arrays import FloatArray
from edged.errors import EdgedError, UserError
from edged.setup.calibration.drafts import Draft
from edged.setup.calibration.guidance import Ghost, Guided
from edged.setup.calibration.model import ViewState
from edged.setup.calibration.shown import Seen, Watched
from edged.vision.boards.board import NominalBoard
from edged.vision.boards.detection import in_words

Polygon = list[list[float]]


class Document(BaseModel):
    """What is told; of texts the English ones, with a code for programs."""

    model_config = ConfigDict(frozen=True)


class Sigma(Document):
    """Standard deviations that the calibration gives to points of the working volume, µm."""

    x: float
    y: float
    z: float


class Thumbnails(Document):
    """Where the small pictures of a view are."""

    left: str
    right: str


class ViewDocument(Document):
    """A pair. why : "left_out" by a person, "not_found", or "excluded": it contradicts the others."""

    name: str
    used: bool
    why: str | None
    why_text: str | None
    rms_px: float | None
    heldout_px: float | None
    thumbnails: Thumbnails


class ShownDocument(Document):
    """A picture of the last live pair. polygon : around the board, raw px. missing : why there is none.

    other_board : which one the pair shows instead, as it is stated, without its size in mm.
    """

    polygon: Polygon | None
    missing: str | None
    text: str | None
    other_board: str | None
    clipped: bool


class BothShown(Document):
    """The last live pair."""

    left: ShownDocument
    right: ShownDocument


class SuggestionDocument(Document):
    """Where to hold the board. right : empty as long as nothing is known of it. sigma_um : with this view."""

    left: Polygon
    right: Polygon
    sigma_um: Sigma | None
    text_code: str
    text: str


class SolvedDocument(Document):
    """What the views were solved to. moved_um : rms distance of points from where the former rig saw them."""

    calibration_id: str
    rms_px: float
    heldout_px: float | None
    sigma_um: Sigma | None
    moved_um: float | None
    verdict: str
    figures: dict[str, JsonValue]


class Trouble(Document):
    """What keeps something from being done. code, params : as of a problem.  text : in English."""

    code: str
    text: str
    params: dict[str, str | float] = {}


class DraftDocument(Document):
    """A draft. waits : why no picture is taken by itself now. trouble : why views give no calibration yet.

    current : live pairs are looked at for it.
    """

    id: str
    revision: int
    created: str
    author: str
    boards: list[str]
    goal_um: float | None
    auto: bool
    waits: str | None
    views: list[ViewDocument]
    shown: BothShown | None
    still: bool
    in_ghost: float
    sigma_um: Sigma | None
    trouble: Trouble | None
    suggestion: SuggestionDocument | None
    suggestions: list[SuggestionDocument]
    more_views: int | None
    guiding: bool
    can_undo: bool
    can_redo: bool
    task: str | None
    solved: SolvedDocument | None
    active: bool
    current: bool


class DraftLine(Document):
    """A draft of the list. trouble : why it cannot be read; then nothing else is known."""

    id: str
    boards: list[str] = []
    views: int = 0
    created: str = ""
    author: str = ""
    active: bool = False
    current: bool = False
    trouble: str | None = None


class DraftList(Document):
    """The youngest first."""

    calibrations: list[DraftLine]


def views_in(draft: Draft, guided: Guided | None, place: str) -> list[ViewDocument]:
    """All that were taken; place : of the draft, as a path."""
    state = draft.state
    kept = state.solved.figures.get("views", {}) if state.solved is not None else {}
    solved: Mapping[str, Any] = kept if isinstance(kept, dict) else {}
    found = []
    for name in state.taken:
        why, text = _why(
            state.views[name], name in state.used, "" if guided is None else guided.excluded.get(name, "")
        )
        figures = solved.get(name) or {}
        rms = figures.get("rms_px", None if guided is None else guided.rms_px.get(name))
        left, right = (f"{place}/views/{name}/{side}.jpg" for side in ("left", "right"))
        found.append(
            ViewDocument(
                name=name,
                used=why is None,
                why=why,
                why_text=text,
                rms_px=None if rms is None else round(rms, 4),
                heldout_px=figures.get("heldout_px"),
                thumbnails=Thumbnails(left=left, right=right),
            )
        )
    return found


def _why(view: ViewState, is_used: bool, excluded: str) -> tuple[str | None, str | None]:
    if not is_used:
        return "left_out", "left out by hand"
    for side, picture in (("left", view.left), ("right", view.right)):
        if picture.outline is None:
            return "not_found", f"{side}: {picture.reason}"
    return ("excluded", excluded) if excluded else (None, None)


def shown_in(watched: Watched | None) -> BothShown | None:
    """The last live pair."""
    if watched is None:
        return None
    other = watched.recognised if watched.left.missing == "other_board" else None
    return BothShown(left=_shown(watched.left, other), right=_shown(watched.right, other))


def trouble_in(error: Exception | None) -> Trouble | None:
    """As it is told; one that is none of ours by its text alone."""
    if error is None:
        return None
    params = dict(error.params) if isinstance(error, UserError) else {}
    return Trouble(
        code=code_of(error) if isinstance(error, EdgedError) else "", text=str(error), params=params
    )


def _shown(seen: Seen, other: NominalBoard | None) -> ShownDocument:
    return ShownDocument(
        polygon=None if seen.outline is None else polygon(seen.outline),
        missing=seen.missing or None,
        text=(seen.reason if other is None else f"the pictures show {in_words(other)}") or None,
        other_board=None if other is None else str(other).rpartition(":")[0],
        clipped=seen.clipped,
    )


def suggestions_in(ghosts: Sequence[Ghost]) -> list[SuggestionDocument]:
    """The best first."""
    return [
        SuggestionDocument(
            left=polygon(ghost.left),
            right=[] if ghost.right is None else polygon(ghost.right),
            sigma_um=sigma(ghost.sigma_um),
            text_code=ghost.code,
            text=ghost.text,
        )
        for ghost in ghosts
    ]


def solved_in(draft: Draft) -> SolvedDocument | None:
    """What its views were solved to."""
    solved = draft.state.solved
    if solved is None:
        return None
    figures: Mapping[str, Any] = solved.figures
    held, moved = figures.get("held_out"), figures.get("moved_um")
    return SolvedDocument(
        calibration_id=solved.calibration_id,
        rms_px=figures["stereo_rms_px"],
        heldout_px=None if held is None else held["reprojection_rms_px"],
        sigma_um=sigma(figures["sigma_um"]),
        moved_um=None if moved is None else moved["rms"],
        verdict=figures["grade"],
        figures=solved.figures,
    )


def sigma(values: FloatArray | Sequence[float] | None) -> Sigma | None:
    """Of X, Y, Z (3,)."""
    if values is None:
        return None
    x, y, z = (round(float(value), 2) for value in values)
    return Sigma(x=x, y=y, z=z)


def polygon(outline: FloatArray) -> Polygon:
    """(N, 2) px."""
    return [[round(float(x), 1), round(float(y), 1)] for x, y in outline]
