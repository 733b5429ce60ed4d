"""Request every route of a cell in every role and compare with what its OpenAPI document states."""

from __future__ import annotations

import asyncio
import base64
import io
import re
from collections.abc import Mapping
from typing import Any

from openapi_spec_validator import OpenAPIV31SpecValidator

from helpers.browsersession import PASSWORD, BrowserSession

ROLES = ("viewer", "operator", "engineer")
BASIC = "Basic " + base64.b64encode(f"edged:{PASSWORD}".encode()).decode()
FITTING = ("1", "left", "nobody", "0" * 12, "20260101-120000-0000", "view_001", "pose_001", "x")
"""Values for path parameters: the first that fits the pattern is used, and none names anything that exists.
"""


async def document_of(browser: BrowserSession) -> dict[str, Any]:
    """OpenAPI document, as the cell serves it."""
    async with browser.session.get("/api/v1/openapi.json", headers={"Authorization": BASIC}) as answer:
        assert 200 == answer.status
        return dict(await answer.json())


def operations(document: dict[str, Any]) -> list[tuple[str, str, dict[str, Any]]]:
    """Method, a matching path, and the document's entry for each operation."""
    found = []
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            fitting = path
            for one in operation["parameters"]:
                if one["in"] == "path":
                    pattern = re.compile(one["schema"].get("pattern", ".*"))
                    value = next(text for text in FITTING if pattern.search(text))
                    fitting = fitting.replace("{" + one["name"] + "}", value)
            assert "{" not in fitting, path
            found.append((method.upper(), fitting, operation))
    return found


async def check_document(browser: BrowserSession) -> dict[str, Any]:
    """Check that it is valid OpenAPI 3.1, operation ids are unique, and no address holds a token."""
    document = await document_of(browser)
    OpenAPIV31SpecValidator(document).validate()
    names = [operation["operationId"] for _, _, operation in operations(document)]
    assert len(names) == len(set(names))
    for _, path, operation in operations(document):
        assert "token" not in [one["name"] for one in operation["parameters"]], path
    for schema in document["components"]["schemas"].values():
        assert schema.get("type") != "object" or "properties" in schema or "additionalProperties" in schema
    return document


async def check_roles(browser: BrowserSession, users: Mapping[str, str]) -> None:
    """Check each route against its stated role; with too low a role, the answer reveals nothing else."""
    document = await document_of(browser)
    for name, role in users.items():
        await browser.log_in(name)
        for method, path, operation in operations(document):
            status, answer = await browser.ask(method, path, {} if method != "GET" else None)
            needed = operation["x-edged-role"]
            if ROLES.index(role) < ROLES.index(needed):
                assert (403, "role") == (status, answer["code"]), path
                assert {"needed": needed, "role": role} == answer["params"]
            else:
                assert 403 != status, path
                assert status < 500 or status == 503, path
                if (method, path) == ("DELETE", "/api/v1/me/sessions"):
                    await browser.log_in(name)


async def check_questions(browser: BrowserSession) -> int:
    """Check the order of checks on every route: authentication, origin, type, size; then the lease.

    Returns how many routes were asked.
    """
    asked = operations(await document_of(browser))
    for method, path, _ in asked:
        assert 401 == (await browser.ask(method, path, {}))[0], path
    for method, path, operation in asked:
        if method != "GET" or operation["x-edged-role"] != "viewer":
            assert (403, "log_in") == await coded(browser, method, path, Authorization=BASIC), path
    await browser.log_in()
    for method, path, operation in asked:
        if method == "GET":
            continue
        for origin in ("http://evil.example", "null", ""):
            assert (403, "origin") == await coded(browser, method, path, Origin=origin), path
        if "requestBody" in operation:
            await refuse_bodies(browser, method, path, operation["x-edged-limit-bytes"])
        if operation["x-edged-lease"]:
            assert (400, "invalid") == await coded(browser, method, path), path
            status, problem = await browser.ask(method, path, {"token": "of nobody"})
            assert (status, problem["code"]) in ((409, "setup_refused"), (400, "invalid")), path
    return len(asked)


async def refuse_bodies(browser: BrowserSession, method: str, path: str, limit_bytes: int) -> None:
    """Check that bad bodies are refused: wrong type, too large (announced or not), no JSON, unknown field."""
    own = {"Origin": browser.origin}
    async with browser.session.request(method, path, data={"a": "b"}, headers=own) as answer:
        assert 415 == answer.status, path
    large = b'{"a": "' + b"x" * limit_bytes + b'"}'
    bodies = ((io.BytesIO(large), 413, "too_large"), (pieces(large), 413, "too_large"), (b"[]", 400, "json"))
    for data, status, code in (*bodies, (b"{", 400, "json"), (b'{"colour": 1}', 400, "invalid")):
        headers = {**own, "Content-Type": "application/json"}
        async with browser.session.request(method, path, data=data, headers=headers) as answer:
            assert (status, code) == (answer.status, (await answer.json())["code"]), path


async def coded(browser: BrowserSession, method: str, path: str, **headers: str) -> tuple[int, str]:
    """Status and error code of the problem."""
    status, problem = await browser.ask(method, path, {}, **headers)
    return status, problem["code"]


async def pieces(data: bytes) -> Any:
    """A body in chunks, without a Content-Length."""
    for start in range(0, len(data), 1000):
        yield data[start : start + 1000]
        await asyncio.sleep(0)
