"""Settings chosen on the page: every setting has its place, and others are refused."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin

import pytest

from edged.adapters.web.assets import read_assets
from edged.config.chosenconnections import ChosenConnections, connections_file
from edged.config.chosensettings import CHOOSABLE
from edged.config.configuration import Config
from edged.config.fields import Section
from edged.config.reading import load
from edged.errors import ConfigError
from edged.setup.cellsettings import NOT_HERE
from edged.setup.plcsettings import ModbusChoice, OpcUaChoice

CELL = '[cell]\nname = "c"\nrig = "rig.json"\njobs = "jobs"\n[cameras]\nsource = "virtual"\n'
ON_A_PAGE: Mapping[str, str] = {
    **{f"cameras.{side}.{key}": "cameras" for side in ("left", "right") for key in ("device", "serial")},
    **{f"cameras.{side}.{key}": "light" for side in ("left", "right") for key in ("exposure_us", "gain_db")},
    **{
        f"modbus.{key}": "plc"
        for key in (
            *("enabled", "host", "port", "unit_id", "word_order", "base_address", "convention"),
            *("readers", "writers", "tls", "socket"),
        )
    },
    **{
        f"opcua.{key}": "plc"
        for key in (
            *("host", "port", "certificate", "key", "trusted", "user", "password_hash"),
            *("anonymous", "readers"),
        )
    },
    "cell.job": "jobs",
}
"""Settings with a page of their own, by name or section, and that page."""


def names(model: type[Section], above: str = "") -> Iterator[str]:
    """The dotted names of all settings of a section and its sub-sections."""
    for key, field in model.model_fields.items():
        kinds = [field.annotation]
        if get_origin(field.annotation) in (Union, UnionType):
            kinds += get_args(field.annotation)
        sections = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Section)]
        name = f"{above}{field.alias or key}"
        if sections:
            yield from names(sections[0], f"{name}.")
        else:
            yield name


def places(name: str) -> list[str]:
    """Where a setting is changed: by itself, or with its section."""
    parts = name.split(".")
    above = {".".join(parts[: end + 1]) for end in range(len(parts))}
    return [
        *("settings" for one in CHOOSABLE if one in above),
        *(page for one, page in ON_A_PAGE.items() if one in above),
        *(f"not: {why}" for one, why in NOT_HERE.items() if one in above),
    ]


def test_everything_that_the_configuration_can_say_is_on_a_page_or_says_why_not() -> None:
    """Each key has exactly one place or reason, no place names an unknown key, and each reason has a
    sentence."""
    every = set(names(Config))
    assert len(every) > 120
    assert {} == {name: found for name in sorted(every) if len(found := places(name)) != 1}
    for one in (*CHOOSABLE, *ON_A_PAGE, *NOT_HERE):
        assert any(name == one or name.startswith(f"{one}.") for name in every), one
    texts = read_assets()["setup/cell/settings.en.ftl"]
    assert [] == [why for why in set(NOT_HERE.values()) if f"settings-not-{why} = " not in texts]


def test_what_is_said_to_be_on_the_plcs_page_is_there() -> None:
    """The models of the PLC's page have these keys and no others."""
    modbus = {name for name, page in ON_A_PAGE.items() if page == "plc" and name.startswith("modbus.")}
    assert {f"modbus.{key}" for key in ModbusChoice.model_fields} == modbus
    opcua = {name for name, page in ON_A_PAGE.items() if page == "plc" and name.startswith("opcua.")}
    assert {f"opcua.{key}" for key in OpcUaChoice.model_fields} == {
        name.removesuffix("_hash") for name in opcua
    }


def chosen(folder: Path, settings: dict[str, Any], more: str = "") -> Config:
    """A cell with these chosen settings."""
    config = folder / "cell.toml"
    config.write_text(CELL + more)
    connections_file(folder / "rig.json").write_text(json.dumps({"settings": settings}))
    return load(config)


def test_a_chosen_setting_counts_before_the_file(tmp_path: Path) -> None:
    """A chosen value overrides the file's, null removes one, the rest stays, and no section is added."""
    more = "exposure_ratio = 4\nleft.exposure_us = 100\nright.exposure_us = 100\n[cycle]\nperiod_s = 2\n"
    settings = {"cycle.mode": "free", "cameras.exposure_ratio": None, "recorder.keep_good": 5}
    config = chosen(tmp_path, settings | {"cameras.left.packet_size": 1500}, more)
    assert ("free", 2.0) == (config.cycle.mode, config.cycle.period_s)
    assert (None, 1500, 100.0) == (
        config.cameras.exposure_ratio,
        config.cameras.left.packet_size,
        config.cameras.left.exposure_us,
    )
    assert config.recorder is None


def test_with_another_trigger_the_files_keys_of_the_former_one_go(tmp_path: Path) -> None:
    """With another trigger mode the file's keys of the former mode are dropped."""
    more = '[cameras.trigger]\nmode = "free-run"\nrate_hz = 5\n'
    trigger = chosen(tmp_path, {"cameras.trigger.mode": "line", "cameras.trigger.line": "Line3"}, more)
    assert ("line", "Line3", None) == (
        trigger.cameras.trigger.mode,
        trigger.cameras.trigger.line,
        trigger.cameras.trigger.rate_hz,
    )


@pytest.mark.parametrize(
    "name", ["web.host", "zenoh.commands", "recorder.folder", "cell.rig", "", "cycle", "modbus.tls"]
)
def test_nothing_else_can_be_chosen(tmp_path: Path, name: str) -> None:
    """Other settings, which open ports or name files, cannot be chosen by the file, either."""
    with pytest.raises(ConfigError, match=r"rig\.connections\.json"):
        chosen(tmp_path, {name: "x"})


def test_a_value_that_does_not_fit_is_named(tmp_path: Path) -> None:
    """A wrong value is named with its place in the configuration."""
    with pytest.raises(ConfigError, match=r"drift: warn_rows_px 3 is beyond"):
        chosen(tmp_path, {"drift.warn_rows_px": 3.0})
    with pytest.raises(ConfigError, match=r"cycle\.period_s"):
        chosen(tmp_path, {"cycle.period_s": "soon"})


def test_a_choice_of_nothing_has_no_file() -> None:
    """An empty choice has no file, and connections are told from other settings."""
    assert ChosenConnections().content() is None
    both = ChosenConnections(settings={"cycle.period_s": 1.0})
    assert (False, {"settings": {"cycle.period_s": 1.0}}) == (
        both.connects,
        json.loads(both.content() or b""),
    )
    assert ChosenConnections(opcua=None).connects
