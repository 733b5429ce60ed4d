"""Connections of PLCs and robots, chosen on the page in the draft of settings."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from edged.adapters.web.routes import Answer, Body, Call, route
from edged.config.chosenconnections import ChosenConnections
from edged.errors import UserError
from edged.identity.passwords import hash_password
from edged.identity.visitors import Role
from edged.robot.orientations import REGISTER_CONVENTIONS, Brand
from edged.setup.draftroutes import Revised, Revision
from edged.setup.inuse import CellInUse
from edged.setup.settingsdraft import SettingsDraft, SettingsDraftDocument

Text = Annotated[str, Field(min_length=1, max_length=200)]
Networks = Annotated[list[Text], Field(max_length=64)]
PortNumber = Annotated[int, Field(ge=1, le=65535)]
ConventionName = Literal[
    "fixed_xyz", "kuka_abc", "ur_rotation_vector", "staubli_xyz", "kawasaki_oat", "abb_zyx"
]


class TlsChoice(Body):
    """Modbus/TCP Security. Files are beside the configuration."""

    certificate: Text
    key: Text
    authority: Text
    writer_roles: Networks


class SocketChoice(Body):
    """The text socket for robots."""

    port: PortNumber
    brand: Brand
    allow_simulated: bool = False


class ModbusChoice(Body):
    """Keys of `[modbus]`. tls, socket : null for none."""

    enabled: bool
    host: Text
    port: PortNumber
    unit_id: int = Field(ge=1, le=247)
    word_order: Literal["high", "low"]
    base_address: int = Field(ge=0, le=60_000)
    convention: ConventionName
    readers: Networks
    writers: Networks
    tls: TlsChoice | None
    socket: SocketChoice | None


class OpcUaChoice(Body):
    """Keys of `[opcua]`. password : a new one; null to keep the present one."""

    host: Text
    port: PortNumber
    certificate: Text | None
    key: Text | None
    trusted: Text | None
    user: Text
    password: Annotated[str, Field(min_length=8, max_length=200)] | None = None
    anonymous: bool
    readers: Networks


class PlcChoice(Body):
    """All connections. opcua : null for no server. revision : of the draft as it was seen; 0 for none."""

    revision: Revision
    modbus: ModbusChoice
    opcua: OpcUaChoice | None


class PlcSettings(Answer):
    """Chosen connections, in the draft if there is one. is_chosen : chosen on the page, not as configured.

    opcua_password : whether there is one. draft : of all settings; null for none. conventions : of A, B, C,
    by the brand of a robot.
    """

    modbus: ModbusChoice
    opcua: OpcUaChoice | None
    opcua_password: bool
    is_chosen: bool
    draft: SettingsDraftDocument | None
    conventions: dict[str, str]


class PlcSettingsRoutes:
    """Routes of the connections of PLCs and robots."""

    def __init__(self, cell: CellInUse, draft: SettingsDraft) -> None:
        self._cell = cell
        self._draft = draft

    @route("GET", "/plc/settings", "How PLCs and robots connect, with the draft", role=Role.VIEWER)
    async def _settings(self, _call: Call[None]) -> PlcSettings:
        return await asyncio.to_thread(self._now)

    @route(
        "PUT",
        "/plc/settings",
        "Let PLCs and robots connect otherwise: in the draft, which is checked",
        limit_bytes=32 * 1024,
    )
    async def _choose(self, call: Call[PlcChoice]) -> PlcSettings:
        return await self._changed(lambda before: self._chosen(call.body, before), call, call.body.revision)

    @route("DELETE", "/plc/settings", "Let PLCs and robots connect as configured: in the draft")
    async def _forget(self, call: Call[Revised]) -> PlcSettings:
        def forget(before: ChosenConnections) -> ChosenConnections:
            return ChosenConnections(settings=before.settings)

        return await self._changed(forget, call, call.body.revision)

    async def _changed(
        self, change: Callable[[ChosenConnections], ChosenConnections], call: Call[Any], revision: int | None
    ) -> PlcSettings:
        await self._draft.change(change, call.visitor.name, revision)
        return await asyncio.to_thread(self._now)

    def _chosen(self, wanted: PlcChoice, before: ChosenConnections) -> ChosenConnections:
        """The choice to store. Raises `UserError` for a file that is not beside the configuration."""
        chosen: dict[str, Any] = wanted.model_dump(mode="json", exclude={"revision"})
        now = self._now()
        for section, known in ((wanted.modbus.tls, now.modbus.tls), (wanted.opcua, now.opcua)):
            for name in ("certificate", "key", "authority", "trusted"):
                path = getattr(section, name, None)
                if path is not None and path != getattr(known, name, None) and not _is_beside(path):
                    raise UserError(f"{name}: {path}: expected a file beside the configuration, by its name")
        if wanted.opcua is not None:
            password = chosen["opcua"].pop("password")
            old = before.opcua or {}
            if password is not None:
                chosen["opcua"]["password_hash"] = hash_password(password)
            elif "password_hash" in old:
                chosen["opcua"]["password_hash"] = old["password_hash"]
        return ChosenConnections(modbus=chosen["modbus"], opcua=chosen["opcua"], settings=before.settings)

    def _now(self) -> PlcSettings:
        configured, chosen = self._draft.configured(), self._draft.chosen()
        folder = self._cell.path.parent
        modbus = {**configured.modbus.model_dump(), **chosen.modbus}
        server = configured.opcua or self._cell.files.config.opcua
        is_on = bool(chosen.opcua) or (chosen.opcua is not None and configured.opcua is not None)
        known = {} if server is None else server.model_dump()
        opcua = {**known, **(chosen.opcua or {})} if is_on else {}
        password = opcua.get("password_hash", "")
        return PlcSettings(
            modbus=ModbusChoice(**_shown(modbus, ModbusChoice, folder)),
            opcua=OpcUaChoice(**_shown(opcua, OpcUaChoice, folder)) if opcua else None,
            opcua_password=bool(password if isinstance(password, str) else password.get_secret_value()),
            is_chosen=chosen.connects,
            draft=self._draft.document(),
            conventions={brand.value: angles.name.lower() for brand, angles in REGISTER_CONVENTIONS.items()},
        )


def _shown(section: dict[str, Any], model: type[Body], folder: Path) -> dict[str, Any]:
    """Keys of a section that the page knows; files as paths relative to the configuration."""
    shown: dict[str, Any] = {}
    for name, value in section.items():
        if name == "tls" and value is not None:
            shown[name] = TlsChoice(**_shown(value, TlsChoice, folder))
        elif name == "socket" and value is not None:
            shown[name] = SocketChoice(**{**value, "brand": Brand(value["brand"])})
        elif name in model.model_fields:
            shown[name] = _beside(value, folder) if isinstance(value, Path) else value
    return shown


def _beside(path: Path, folder: Path) -> str:
    return str(path.relative_to(folder) if path.is_relative_to(folder) else path)


def _is_beside(path: str) -> bool:
    return not Path(path).is_absolute() and ".." not in Path(path).parts and not path.startswith("~")
