"""A stub of hawkBit's Direct Device Integration API, written after its public description, for one tenant.

hawkBit itself is Java and in no package index that the tests use. The stub refuses what the description does
not allow: a wrong token, feedback with words that DDI does not know, feedback for a closed action.
"""

from __future__ import annotations

import http.server
import json
import re
from pathlib import Path
from typing import Any

EXECUTIONS = {
    "closed",
    "proceeding",
    "canceled",
    "scheduled",
    "rejected",
    "resumed",
    "downloaded",
    "download",
}
RESULTS = {"success", "failure", "none"}
PLACE = re.compile(
    r"/(?P<tenant>\w+)/controller/v1/(?P<cell>[^/]+)"
    r"(?:/(?P<kind>deploymentBase|cancelAction)/(?P<id>\w+)(?P<feedback>/feedback)?)?"
)


class DdiStub:
    """The server's state: assignments by action, cancelled actions, and the feedback received."""

    def __init__(self, token: str) -> None:
        self.token = token
        self.files: dict[str, tuple[str, str]] = {}
        self.stops: set[str] = set()
        self.fed: list[tuple[str, str, str, str, str]] = []

    def assign(self, action: str, file: Path, name: str, sha256: str) -> None:
        """Assign a distribution set with one software module of one file."""
        assert file.is_file()
        self.files[action] = (name, sha256)

    @property
    def open_actions(self) -> list[str]:
        """Actions without closing feedback, in order of assignment."""
        closed = {action for _, action, execution, _, _ in self.fed if execution in ("closed", "canceled")}
        return [action for action in self.files if action not in closed]

    def get(self, host: str, place: re.Match[str]) -> tuple[int, Any]:
        """Status and document of a GET request."""
        base = f"https://{host}/{place['tenant']}/controller/v1/{place['cell']}"
        if place["kind"] is None:
            links = {"configData": {"href": f"{base}/configData"}}
            stops = [action for action in self.open_actions if action in self.stops]
            if stops:
                links["cancelAction"] = {"href": f"{base}/cancelAction/{stops[0]}"}
            elif self.open_actions:
                links["deploymentBase"] = {
                    "href": f"{base}/deploymentBase/{self.open_actions[0]}?c=-2122565939"
                }
            return 200, {"config": {"polling": {"sleep": "00:05:00"}}, "_links": links}
        if place["id"] not in self.files:
            return 404, {"errorCode": "hawkbit.server.error.repo.entitiyNotFound"}
        if place["kind"] == "cancelAction":
            return 200, {"id": place["id"], "cancelAction": {"stopId": place["id"]}}
        name, sha256 = self.files[place["id"]]
        artifact = {
            "filename": name,
            "hashes": {"sha1": "0" * 40, "md5": "0" * 32, "sha256": sha256},
            "size": 3,
            "_links": {"download": {"href": f"{base}/softwaremodules/1/artifacts/{name}"}},
        }
        chunk = {"part": "bApp", "version": "1", "name": "jobs", "artifacts": [artifact]}
        return 200, {
            "id": place["id"],
            "deployment": {"download": "forced", "update": "forced", "chunks": [chunk]},
        }

    def post(self, place: re.Match[str], body: Any) -> int:
        """Status of the reply to a feedback."""
        status, details = body["status"], body["status"]["details"]
        execution, finished = status["execution"], status["result"]["finished"]
        if not (body.keys() <= {"timestamp", "status"} and isinstance(body.get("timestamp"), int)):
            return 400
        if execution not in EXECUTIONS or finished not in RESULTS or any(len(text) > 512 for text in details):
            return 400
        if place["id"] not in self.open_actions:
            return 410
        self.fed.append((place["kind"], place["id"], execution, finished, details[0]))
        if execution == "rejected":
            self.stops.discard(place["id"])
        return 200

    def handler(self) -> type[http.server.BaseHTTPRequestHandler]:
        """Request handler class for an HTTP server."""
        stub = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.answer(lambda place, _: stub.get(self.headers["Host"], place))

            def do_POST(self) -> None:
                self.answer(lambda place, body: (stub.post(place, body), None))

            def answer(self, ask: Any) -> None:
                length = int(self.headers.get("Content-Length") or 0)
                body = json.loads(self.rfile.read(length)) if length else None
                place = PLACE.fullmatch(self.path.partition("?")[0])
                code, document = 401, None
                if self.headers.get("Authorization") == stub.token:
                    code, document = (404, None) if place is None else ask(place, body)
                self.send_response(code)
                self.send_header("Content-Type", "application/hal+json")
                data = b"" if document is None else json.dumps(document).encode()
                self.send_header("Content-Length", str(len(data)))
                self.end_headers()
                self.wfile.write(data)

            def log_message(self, format: str, *arguments: object) -> None:
                """Suppress the log."""

        return Handler
