"""The table of routes as an OpenAPI 3.1 document."""

from __future__ import annotations

from http import HTTPStatus
from typing import Any

from pydantic import BaseModel, ConfigDict, Field
from pydantic.json_schema import models_json_schema

from edged import __version__
from edged.adapters.web.routes import BASE, WEBSOCKET, Answer, Route, RouteTable
from edged.payload import Json

PLACE = "#/components/schemas/{model}"


class ProblemDocument(Answer):
    """What was wrong (RFC 9457); fields without a value are left out."""

    model_config = ConfigDict(json_schema_serialization_defaults_required=False)

    status: int
    code: str = Field(description="for programs")
    detail: str = Field(description="for people, in English")
    field: str | None = Field(None, description="of the body, as a path with dots")
    params: dict[str, Any] | None = Field(None, description="what a sentence of one's own for the code needs")


def document_of(table: RouteTable, cell: str, cookie: str) -> Json:
    """Every route with its parameters, body and responses; `x-edged-…` say who may use it, and what it needs.

    cookie : name of the session cookie.
    """
    bodies = {route.body for route in table if route.body is not None and route.changes}
    answers = {route.answer for route in table if isinstance(route.answer, type)} | {ProblemDocument}
    models: list[Any] = [(model, "validation") for model in sorted(bodies, key=_name)]
    models += [(model, "serialization") for model in sorted(answers, key=_name)]
    references, schemas = models_json_schema(models, ref_template=PLACE)
    paths: dict[str, Json] = {}
    for route in table:
        paths.setdefault(route.plain_path, {})[route.method.lower()] = _operation(route, references)
    return {
        "openapi": "3.1.0",
        "info": {"title": f"edged: {cell}", "version": __version__, "summary": "Setting a cell up"},
        "paths": paths,
        "components": {
            "schemas": schemas["$defs"],
            "securitySchemes": {"page": {"type": "apiKey", "in": "cookie", "name": cookie}},
        },
        "security": [{"page": []}],
    }


def _operation(route: Route, references: Any) -> Json:
    described = HTTPStatus(101 if route.answer == WEBSOCKET else route.status)
    success: Json = {"description": described.phrase}
    if isinstance(route.answer, type):
        schema = references[route.answer, "serialization"]
        success["content"] = {"application/json": {"schema": schema}}
    elif route.answer is not None and route.answer != WEBSOCKET:
        success["content"] = {route.answer: {}}
    problem = {"schema": references[ProblemDocument, "serialization"]}
    operation: Json = {
        "operationId": _identifier(route),
        "summary": route.what,
        "parameters": [*map(_path_parameter, *zip(*route.parameters, strict=True))]
        if route.parameters
        else [],
        "responses": {
            str(described.value): success,
            "default": {
                "description": "a problem, with its code",
                "content": {"application/problem+json": problem},
            },
        },
        "x-edged-role": route.role.word,
        "x-edged-audit": route.audit,
        "x-edged-lease": route.needs_lease,
        "x-edged-password": route.needs_password,
    }
    if route.body is not None and route.changes:
        schema = references[route.body, "validation"]
        operation["requestBody"] = {"required": True, "content": {"application/json": {"schema": schema}}}
    elif route.body is not None:
        operation["parameters"] += _query_parameters(route.body)
    if route.changes:
        operation["x-edged-limit-bytes"] = route.limit_bytes
    return operation


def _path_parameter(name: str, pattern: str) -> Json:
    schema: Json = {"type": "string", "pattern": f"^(?:{pattern})$"} if pattern else {"type": "string"}
    return {"name": name, "in": "path", "required": True, "schema": schema}


def _query_parameters(model: type[BaseModel]) -> list[Json]:
    schema = model.model_json_schema()
    required = schema.get("required", ())
    return [
        {"name": name, "in": "query", "required": name in required, "schema": parameter}
        for name, parameter in schema["properties"].items()
    ]


def _identifier(route: Route) -> str:
    words = route.plain_path.removeprefix(BASE).replace(".", "/").replace("{", "").replace("}", "").split("/")
    return "_".join([route.method.lower(), *(word for word in words if word)])


def _name(model: type[BaseModel]) -> str:
    return f"{model.__name__} {model.__module__}"
