"""Settings of the configuration that can be chosen on the page, in a draft to be activated or discarded."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from edged.adapters.web.routes import Answer, Body, Call, Reason, Token, route
from edged.config.cameras import MODE_KEYS
from edged.config.chosensettings import CHOOSABLE, TRIGGER, Scalar, at, refuse_unknown
from edged.config.configuration import Config
from edged.config.tomltext import toml_of
from edged.errors import UserError
from edged.identity.visitors import Role
from edged.setup.draftroutes import Nothing, Revision
from edged.setup.inuse import CellInUse
from edged.setup.releases.routes import mandate
from edged.setup.releases.service import Activation
from edged.setup.settingsdraft import SettingsDraft, SettingsDraftDocument

NOT_HERE: Mapping[str, str] = {
    "cell.name": "names",
    "cell.rig": "names",
    "cell.jobs": "names",
    "recorder.folder": "names",
    "web": "web",
    "cameras.source": "wiring",
    "cameras.folder": "wiring",
    "cameras.left.count": "wiring",
    "cameras.right.count": "wiring",
    "cameras.left.strobe": "wiring",
    "cameras.right.strobe": "wiring",
    "cameras.left.features": "wiring",
    "cameras.right.features": "wiring",
    "modbus.serial": "wiring",
    "modbus.reserved": "strangers",
    "plc": "plc",
    "ethernetip": "strangers",
    "zenoh.enabled": "strangers",
    "zenoh.listen": "strangers",
    "zenoh.connect": "strangers",
    "zenoh.config_file": "strangers",
    "zenoh.commands": "strangers",
    "zenoh.shared_key": "strangers",
    "history": "names",
    "fleet": "strangers",
    "limits": "bounds",
    "belt": "wiring",
    "registration": "bounds",
    "marks": "bounds",
}
"""Options that can only be changed in the configuration file, with the page's reason (`settings-not-...`)."""


class Setting(Answer):
    """A setting that can be chosen. value : in force. configured : in the file, or default; null if unset.

    chosen : it is chosen on the page, in the draft if there is one. wanted : the chosen value, else the
    configured one. low, high : known bounds. can_be_left_out : null is allowed. modes : trigger modes that it
    belongs to; empty for all. help : in English, as in the manual.
    """

    name: str
    kind: Literal["yes_no", "choice", "whole", "number", "text"]
    options: list[str]
    low: float | None
    high: float | None
    can_be_left_out: bool
    modes: list[str]
    help: str
    value: Scalar | None
    configured: Scalar | None
    chosen: bool
    wanted: Scalar | None


class SettingsNow(Answer):
    """All settings, in the order of the configuration; options not offered, by reason; the draft, if any."""

    settings: list[Setting]
    not_here: dict[str, list[str]]
    draft: SettingsDraftDocument | None


class Choosing(Body):
    """All chosen settings, by dotted names; others are as configured. null : unset.

    revision : of the draft as it was seen; 0 for none.
    """

    revision: Revision

    chosen: Annotated[
        dict[str, Annotated[Scalar, Field(union_mode="left_to_right")] | None], Field(max_length=200)
    ]


class ActivatingSettings(Body):
    """Request to activate: the reason, and the token while there is a lease."""

    token: Token | None = None
    note: Reason


class SettingsRoutes:
    """Routes of settings."""

    def __init__(self, cell: CellInUse, activation: Activation, draft: SettingsDraft) -> None:
        self._cell = cell
        self._activation = activation
        self._draft = draft

    @route(
        "GET",
        "/settings",
        "Settings that can be chosen here, what is in force, and the draft",
        role=Role.VIEWER,
    )
    async def _settings(self, _call: Call[None]) -> SettingsNow:
        return await asyncio.to_thread(self._now)

    @route("PUT", "/settings", "Choose settings: in the draft, which is checked", limit_bytes=32 * 1024)
    async def _choose(self, call: Call[Choosing]) -> SettingsNow:
        try:
            chosen = dict(refuse_unknown(call.body.chosen))
        except ValueError as error:
            raise UserError(str(error)) from None
        await self._draft.change(
            lambda before: before.model_copy(update={"settings": chosen}),
            call.visitor.name,
            call.body.revision,
        )
        return await asyncio.to_thread(self._now)

    @route("DELETE", "/settings", "Discard the draft of settings and connections", audit=True)
    async def _discard(self, _call: Call[Nothing]) -> SettingsNow:
        await self._draft.discard()
        return await asyncio.to_thread(self._now)

    @route(
        "POST",
        "/settings/activate",
        "Let the cell run by the draft of settings and connections, as a release",
        audit=True,
        needs_password=True,
    )
    async def _activate(self, call: Call[ActivatingSettings]) -> SettingsNow:
        await self._activation.check(call.body.token)
        call.trail.before = self._draft.fingerprint
        draft = await asyncio.to_thread(self._draft.document)
        names = [] if draft is None else [change.name or "" for change in draft.changes]
        call.trail.object = ", ".join(names)[:500]
        await self._draft.activate(mandate(call, call.body.note))
        call.trail.after = self._draft.fingerprint
        return await asyncio.to_thread(self._now)

    def _now(self) -> SettingsNow:
        draft, chosen = self._draft.document(), self._draft.chosen().settings
        config = self._cell.files.config
        file = toml_of(self._cell.files.contents["cell.toml"])
        in_force = config.model_dump(mode="json", by_alias=True)
        not_here: dict[str, list[str]] = {}
        for name, reason in NOT_HERE.items():
            not_here.setdefault(reason, []).append(name)
        return SettingsNow(
            settings=list(_settings_of(in_force, file, chosen)), not_here=not_here, draft=draft
        )


def _settings_of(
    in_force: Mapping[str, Any], file: Mapping[str, Any], chosen: Mapping[str, Scalar | None]
) -> Iterator[Setting]:
    whole = Config.model_json_schema()
    for name in CHOOSABLE:
        section = name.partition(".")[0]
        if in_force.get(section) is None:
            continue
        form = _form(whole, name)
        written = at(file, name)
        default = form.get("default")
        configured = default if written is None else written
        yield Setting(
            name=name,
            modes=_modes(name),
            help=str(form.get("description", "")),
            value=at(in_force, name),
            configured=configured,
            chosen=name in chosen,
            wanted=chosen.get(name, configured),
            **_kind(form),
        )


def _modes(name: str) -> list[str]:
    section, _, key = name.rpartition(".")
    if section != TRIGGER:
        return []
    return [mode for mode, keys in MODE_KEYS.items() if key in keys]


def _form(whole: Mapping[str, Any], name: str) -> dict[str, Any]:
    """JSON schema of a setting."""
    form: Mapping[str, Any] = whole
    for key in name.split("."):
        form = _resolved(whole, form)["properties"][key]
    return dict(form)


def _resolved(whole: Mapping[str, Any], form: Mapping[str, Any]) -> Mapping[str, Any]:
    """Resolve the reference to a section's schema, also of an optional section (that schema or null)."""
    for part in (form, *form.get("anyOf", ())):
        if "$ref" in part:
            return dict(whole["$defs"][part["$ref"].rpartition("/")[2]])
    return form


def _kind(form: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a `Setting` that describe its allowed values."""
    value = next((part for part in form.get("anyOf", ()) if part.get("type") != "null"), form)
    kinds = {"boolean": "yes_no", "integer": "whole", "number": "number"}
    return {
        "kind": "choice" if "enum" in value else kinds.get(value["type"], "text"),
        "options": value.get("enum", []),
        "low": value.get("minimum", value.get("exclusiveMinimum")),
        "high": value.get("maximum", value.get("exclusiveMaximum")),
        "can_be_left_out": any(other.get("type") == "null" for other in form.get("anyOf", ())),
    }
