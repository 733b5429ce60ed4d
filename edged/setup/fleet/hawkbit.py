"""Client of hawkBit, which assigns releases to cells, by its Direct Device Integration API; one poll a call.

hawkBit is trusted with nothing else: it assigns a file name and a SHA-256, and the cell takes the release of
its plant that is signed with both from the repository. The gate's progress is sent back as feedback.
Source: hawkBit's REST documentation of DDI v1 (controller base, deploymentBase, cancelAction, feedback).
"""

from __future__ import annotations

import json
import re
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

from edged.errors import UserError
from edged.files.atomic import write_atomically
from edged.setup.documents import read_model
from edged.setup.fleet.offers import DONE, FOLDER, GateNote, Offer, gate_in
from edged.setup.history import Kept, Text

NOTE = "hawkbit.json"
"""File in the folder of releases: the current action, and the feedback sent last."""
TIMEOUT_S = 20.0
MAX_BYTES = 4 * 1024 * 1024
MAX_DETAIL = 500
"""hawkBit keeps 512 characters of a message."""
AUTHORIZATION = re.compile(r"(Target|Gateway)Token \S{1,512}")
SUCCESS, FAILURE, OPEN = ("closed", "success"), ("closed", "failure"), ("proceeding", "none")
"""Execution and result, in DDI's terms."""


class HawkbitAction(Kept):
    """An assignment. path : of the release; "" if none such is signed. reported : the last feedback sent."""

    id: Text
    path: Text
    reported: Text = ""


class Hawkbit:
    """Client of a server for one cell. folder : of the page. Raises `UserError` if it fails to answer."""

    def __init__(self, url: str, authorization: str, cell: str, folder: Path) -> None:
        if AUTHORIZATION.fullmatch(authorization) is None:
            raise UserError("fleet.hawkbit_token: expected a file with TargetToken ... or GatewayToken ...")
        self._base = f"{url.rstrip('/')}/controller/v1/{quote(cell, safe='')}"
        self._authorization = authorization
        self._folder = folder / FOLDER
        self._opener = urllib.request.build_opener(_NoRedirect)

    def due(self, offers: Mapping[str, Offer], digest: Callable[[str], str]) -> dict[str, tuple[str, Offer]]:
        """Release assigned to this cell, by kind; also reports the gate's progress. digest : of a path."""
        try:
            return self._due(offers, digest)
        except (KeyError, TypeError, AttributeError) as error:
            raise UserError(f"{self._base}: answers otherwise than DDI: {error!r}") from error

    def _due(self, offers: Mapping[str, Offer], digest: Callable[[str], str]) -> dict[str, tuple[str, Offer]]:
        links = self._ask("").get("_links", {})
        gate = gate_in(self._folder)
        if "cancelAction" in links:
            self._cancel(self._ask(_below(links["cancelAction"])), gate)
        action = self._action()
        if "deploymentBase" in links:
            found = self._ask(_below(links["deploymentBase"]))
            if action is None or action.id != str(found["id"]):
                path = _assigned(found, offers, digest)
                action = self._keep(HawkbitAction(id=str(found["id"]), path=path))
        if action is None:
            return {}
        self._tell(action, gate, offers)
        offer = offers.get(action.path)
        return {} if offer is None else {offer.kind: (action.path, offer)}

    def _tell(self, action: HawkbitAction, gate: GateNote | None, offers: Mapping[str, Offer]) -> None:
        state, words = OPEN, "fetched next"
        if action.path not in offers:
            state, words = FAILURE, "the plant has signed no release of this name and SHA-256"
        elif gate is not None and gate.staged.path == action.path:
            words = f"{gate.step}: {gate.why}"
            if gate.step in DONE:
                state = SUCCESS if gate.step == "committed" else FAILURE
        if action.reported != words:
            self._feed(f"deploymentBase/{quote(action.id, safe='')}", state, words)
            self._keep(action.model_copy(update={"reported": words}))

    def _cancel(self, found: Mapping[str, Any], gate: GateNote | None) -> None:
        """Answer a cancellation: rejected if the gate has begun with the release, otherwise carried out."""
        action, stopped = self._action(), str(found["cancelAction"]["stopId"])
        is_ours = action is not None and action.id == stopped
        begun = gate is not None and action is not None and gate.staged.path == action.path
        if is_ours and begun:
            words = "the gate has it already"
            self._feed(f"cancelAction/{quote(str(found['id']), safe='')}", ("rejected", "failure"), words)
            return
        self._feed(f"cancelAction/{quote(str(found['id']), safe='')}", ("canceled", "success"), "not fetched")
        if is_ours:
            (self._folder / NOTE).unlink()

    # --- HTTP and files -----------------------------------------------------------------------------

    def _action(self) -> HawkbitAction | None:
        file = self._folder / NOTE
        return read_model(file, HawkbitAction, "an action of hawkBit") if file.exists() else None

    def _keep(self, action: HawkbitAction) -> HawkbitAction:
        write_atomically(self._folder / NOTE, action.model_dump_json(indent=1).encode(), is_state=True)
        return action

    def _feed(self, place: str, state: tuple[str, str], words: str) -> None:
        status = {
            "execution": state[0],
            "result": {"finished": state[1]},
            "details": [words[:MAX_DETAIL]],
        }
        self._ask(f"{place}/feedback", {"timestamp": time.time_ns() // 1_000_000, "status": status})

    def _ask(self, place: str, body: Any = None) -> dict[str, Any]:
        url = f"{self._base}/{place}".rstrip("/")
        request = urllib.request.Request(url, None if body is None else json.dumps(body).encode())
        request.add_header("Authorization", self._authorization)
        request.add_header("Accept", "application/hal+json, application/json")
        request.add_header("Content-Type", "application/json")
        try:
            with self._opener.open(request, timeout=TIMEOUT_S) as answer:
                said = answer.read(MAX_BYTES)
            found = json.loads(said) if said.strip() else {}
        except (urllib.error.URLError, OSError, ValueError) as error:
            if isinstance(error, urllib.error.HTTPError):
                error.close()
            raise UserError(f"{url}: {error}") from error
        return found if isinstance(found, dict) else {}


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Refuses redirects, so that the token is only sent to the configured server."""

    def redirect_request(self, *_: Any, **__: Any) -> None:
        """Follow no redirect."""


def _below(link: Any) -> str:
    """Path of a link relative to the cell's base URL; the link's host may be hawkBit's internal one."""
    path = urlsplit(link["href"]).path
    found = re.search(r"/controller/v1/[^/]+/((?:deploymentBase|cancelAction)/[^/]+)$", path)
    if found is None:
        raise UserError(f"hawkBit: a link that DDI has not: {str(link['href'])[:200]}")
    return found[1]


def _assigned(found: Mapping[str, Any], offers: Mapping[str, Offer], digest: Callable[[str], str]) -> str:
    """Path of the release that is signed with name and hash of an assigned file; "" unless exactly one is."""
    files = {
        (artifact["filename"], artifact.get("hashes", {}).get("sha256"))
        for chunk in found["deployment"]["chunks"]
        for artifact in chunk.get("artifacts") or ()
    }
    signed = [path for path in offers if (path.split("/", 1)[1], digest(path)) in files]
    return signed[0] if len(signed) == 1 else ""
