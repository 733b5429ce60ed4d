"""A registrar for cells without files: it accepts poses but never saves."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from edged.config.cell import RegistrationSection
from edged.errors import UserError
from edged.setup.registration.registrar import CellRegistrar
from helpers.livecell import LiveCell
from helpers.rigs import make_rig


def registrar_of(cell: LiveCell) -> CellRegistrar:
    """The product's registrar, for this cell's setup."""
    section = RegistrationSection(board="chessboard:9x6:4.0")
    config = SimpleNamespace(registration=section, cell=SimpleNamespace(rig=Path(__file__)))
    loaded: Any = SimpleNamespace(
        cell=SimpleNamespace(config=config, rig=make_rig(), contents={"rig.json": b""}), setup=cell.setup
    )

    async def never(_base: Any, _solved: Any) -> Any:
        raise UserError("nothing is saved here")

    return CellRegistrar(SimpleNamespace(loaded=loaded, register=never))
