"""Documents of calibration drafts, served under /api/v1 and sent to every open page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import JsonValue

from edged.domain.arrays import FloatArray
from edged.setup.calibration.guidance import Ghost, Guided
from edged.setup.calibration.model import DraftState, ViewState
from edged.setup.calibration.shown import Seen, Watched
from edged.setup.documents import DraftHead, DraftSummary, Frozen, Message, PicturePaths, SigmaXyz, Trouble
from edged.vision.boards.board import NominalBoard
from edged.vision.boards.detection import in_words

PLACE = "/api/v1/calibrations"
Polygon = list[list[float]]


class ViewDocument(Frozen):
    """A pair. why : reason not to use it: "left_out" by hand, "not_found", or "excluded" as inconsistent."""

    name: str
    used: bool
    why: Message | None
    why_text: str | None
    rms_px: float | None
    heldout_px: float | None
    thumbnails: PicturePaths


class ShownDocument(Frozen):
    """A picture of the last live pair. polygon : around the board, raw px. missing : why there is none.

    other_board : specification of the board that is seen instead, without its size in mm.
    """

    polygon: Polygon | None
    missing: str | None
    text: str | None
    other_board: str | None
    clipped: bool


class BothShown(Frozen):
    """Both pictures of the last live pair."""

    left: ShownDocument
    right: ShownDocument


class SuggestionDocument(Frozen):
    """Where to hold the board. right : empty while it is not known. sigma_um : expected with this view."""

    left: Polygon
    right: Polygon
    sigma_um: SigmaXyz | None
    text_code: str
    text: str


class SolvedDocument(Frozen):
    """A solved calibration. moved_um : rms distance of points from where the former rig saw them."""

    calibration_id: str
    rms_px: float
    heldout_px: float | None
    sigma_um: SigmaXyz | None
    moved_um: float | None
    verdict: str
    figures: dict[str, JsonValue]


class DraftDocument(DraftHead):
    """A draft. waits : why no picture is taken automatically now. trouble : why there is no calibration yet.

    current : live pairs are analysed for it.
    """

    boards: list[str]
    goal_um: float | None
    auto: bool
    waits: str | None
    views: list[ViewDocument]
    shown: BothShown | None
    still: bool
    in_ghost: float
    sigma_um: SigmaXyz | None
    trouble: Trouble | None
    suggestion: SuggestionDocument | None
    suggestions: list[SuggestionDocument]
    more_views: int | None
    guiding: bool
    task: str | None
    solved: SolvedDocument | None
    current: bool


class DraftLine(DraftSummary):
    """A draft in the list. trouble : why it cannot be read; then only its id is known."""

    boards: list[str] = []  # noqa: RUF012  (pydantic copies it)
    views: int = 0
    solved: bool = False
    current: bool = False


class DraftList(Frozen):
    """All drafts, newest first."""

    calibrations: list[DraftLine]


def guided_in(state: DraftState, guided: Guided | None, ghost: Ghost | None) -> dict[str, Any]:
    """Fields of a `DraftDocument` that depend on the views in use. ghost : the one offered."""
    known = guided or Guided(None, ())
    suggestions = [_suggestion(ghost) for ghost in known.ghosts]
    return {
        "boards": list(state.boards),
        "goal_um": state.goal_um,
        "views": [_view(state, name, known) for name in state.taken],
        "solved": _solved(state),
        "sigma_um": _sigma(known.sigma_um),
        "suggestion": None if ghost is None else _suggestion(ghost),
        "suggestions": suggestions,
        "more_views": known.more_views,
    }


def _view(state: DraftState, name: str, guided: Guided) -> ViewDocument:
    why, text = _why(state.views[name], name in state.used, guided.excluded.get(name, ""))
    views: Any = {} if state.solved is None else state.solved.figures.get("views")
    figures = (views or {}).get(name) or {}
    rms = figures.get("rms_px", guided.rms_px.get(name))
    return ViewDocument(
        name=name,
        used=why is None,
        why=why,
        why_text=text,
        rms_px=None if rms is None else round(rms, 4),
        heldout_px=figures.get("heldout_px"),
        thumbnails=PicturePaths.below(f"{PLACE}/{state.id}/views/{name}"),
    )


def _why(view: ViewState, is_used: bool, excluded: str) -> tuple[str | None, str | None]:
    if not is_used:
        return "left_out", "left out by hand"
    for side, picture in (("left", view.left), ("right", view.right)):
        if picture.outline is None:
            return "not_found", f"{side}: {picture.reason}"
    return ("excluded", excluded) if excluded else (None, None)


def shown_in(watched: Watched | None) -> BothShown | None:
    """Document of the last live pair."""
    if watched is None:
        return None
    other = watched.recognised if watched.left.missing == "other_board" else None
    return BothShown(left=_shown(watched.left, other), right=_shown(watched.right, other))


def _shown(seen: Seen, other: NominalBoard | None) -> ShownDocument:
    return ShownDocument(
        polygon=None if seen.outline is None else _polygon(seen.outline),
        missing=seen.missing or None,
        text=(seen.reason if other is None else f"the pictures show {in_words(other)}") or None,
        other_board=None if other is None else str(other).rpartition(":")[0],
        clipped=seen.clipped,
    )


def _suggestion(ghost: Ghost) -> SuggestionDocument:
    return SuggestionDocument(
        left=_polygon(ghost.left),
        right=[] if ghost.right is None else _polygon(ghost.right),
        sigma_um=_sigma(ghost.sigma_um),
        text_code=ghost.code,
        text=ghost.text,
    )


def _solved(state: DraftState) -> SolvedDocument | None:
    if state.solved is None:
        return None
    figures: Mapping[str, Any] = state.solved.figures
    held, moved = figures.get("held_out"), figures.get("moved_um")
    return SolvedDocument(
        calibration_id=state.solved.calibration_id,
        rms_px=figures["stereo_rms_px"],
        heldout_px=held and held["reprojection_rms_px"],
        sigma_um=_sigma(figures["sigma_um"]),
        moved_um=moved and moved["rms"],
        verdict=figures["grade"],
        figures=state.solved.figures,
    )


def _sigma(values: FloatArray | Sequence[float] | None) -> SigmaXyz | None:
    """Document of sigmas (3,) of X, Y, Z."""
    if values is None:
        return None
    x, y, z = (round(float(value), 2) for value in values)
    return SigmaXyz(x=x, y=y, z=z)


def _polygon(outline: FloatArray) -> Polygon:
    """Outline (N, 2) in px as lists, rounded."""
    return [[round(float(x), 1), round(float(y), 1)] for x, y in outline]
