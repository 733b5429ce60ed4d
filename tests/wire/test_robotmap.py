"""A cell with a map of its robot's error: OPC UA, Modbus, lines of text, and its state as JSON."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from asyncua import Client
from helpers.linerobot import connected, ready
from helpers.opcuacell import OpcUaCell, client_of
from helpers.schema_check import load_schema, violations
from helpers.snapshots import make_target

from edged.adapters.modbus import LineSettings, ModbusSettings
from edged.adapters.opcua import OpcUaSettings
from edged.domain.cell import CellPhase, CellState
from edged.domain.measurement import Reject
from edged.domain.robotmap import RobotMap
from edged.payload import state_to_json
from edged.plc.lines import LineStatus
from edged.robot.errormap import ErrorMap, hull_of
from edged.robot.orientations import Brand

INSIDE, BEYOND = make_target(x_mm=10.0), make_target(x_mm=500.0)
LINES = ModbusSettings(port=0, validity_s=30.0, line=LineSettings(0, Brand.KUKA))


def small_map() -> ErrorMap:
    """A map around `INSIDE`: the robot is off by some tenths of a millimetre, and by 0.1 % of X."""
    rng = np.random.default_rng(2)
    corners = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    places = np.concatenate([corners, rng.uniform(-1, 1, (16, 3))]) * (100.0, 90.0, 60.0) + (0, 0, 200.0)
    shown = places + (0.2, -0.1, 0.3) + 1e-3 * places[:, :1] + rng.normal(0, 0.02, places.shape)
    return ErrorMap(RobotMap(places, shown, 1, hull_of(places)))


async def shown(client: Client, block: str, name: str) -> Any:
    """Value of a register over OPC UA; None where it has none."""
    node = client.get_node(f"ns=3;s=Registers.{block}.{name}")
    data = await node.read_data_value(raise_on_bad_status=False)
    return data.Value.Value if data.StatusCode.is_good() else None


@pytest.mark.long
async def test_the_map_is_in_all_that_a_running_cell_says() -> None:
    """After a reload with a map, OPC UA, Modbus and lines give its X, and registers its quality; a part
    beyond the map has no coordinate but a bit with the reason."""
    made = small_map()
    shift = made.at(INSIDE.position_mm)
    assert shift is not None
    with OpcUaCell(OpcUaSettings("cell1", port=0, anonymous=True), LINES) as cell, connected(cell) as robot:
        await asyncio.to_thread(ready, cell)
        async with client_of(cell.url) as client:

            async def located(sequence: int) -> tuple[int, list[float], Any, int]:
                """Status and pose of the line; X and REJECT over OPC UA, which equal those of Modbus."""
                cell.targets = (INSIDE,) if sequence != 3 else (BEYOND,)
                _, status, _, pose = await asyncio.to_thread(robot.ask, f"{sequence},LOCATE,0")
                async with asyncio.timeout(10.0):
                    while True:
                        if await shown(client, "status", "CMD_SEQ_ECHO") == sequence:
                            break
                        await asyncio.sleep(0.01)
                x_um, reject = [await shown(client, "result", name) for name in ("X", "REJECT")]
                values = cell.call(lambda: {one.name: value for one, value in cell.server.values()})
                assert reject == values["REJECT"]
                assert x_um is None or x_um == values["X"]
                return status, pose, x_um, reject

            assert 0 == await shown(client, "robot map", "E_DEGREE")
            plain = await located(1)
            cell.reload(error_map=made)
            status, pose, x_um, reject = await located(2)
            assert (0, Reject.NONE) == (status, reject)
            assert x_um == pytest.approx(plain[2] + 1e3 * shift.shift_mm[0], abs=1.0)
            assert pose[0] == pytest.approx(x_um / 1000, abs=1e-3)
            figures = made.figures
            assert [1, 24] == [await shown(client, "robot map", name) for name in ("E_DEGREE", "E_POINTS")]
            worth = {
                "E_ALONE": figures.alone_mm,
                "E_HELD_OUT": figures.held_out_mm,
                "E_NOISE": figures.noise_mm,
            }
            for name, mm in worth.items():
                assert round(1e4 * mm) == await shown(client, "robot map", name)
            assert figures.held_out_mm < 0.5 * figures.alone_mm
            status, _, x_um, reject = await located(3)
            assert (LineStatus.OUT_OF_LIMITS, None, Reject.OUT_OF_MAP) == (status, x_um, reject)
            cell.reload(error_map=None)
            again = await located(4)  # the last field of a line is its duration
            assert (plain[0], plain[1][:9], *plain[2:]) == (again[0], again[1][:9], *again[2:])
            assert 0 == await shown(client, "robot map", "E_DEGREE")


def test_the_state_has_it_as_the_schema_says() -> None:
    """The state has it only with a map, with exactly the fields of the schema."""
    plain = CellState(CellPhase.READY, True, True, "flange", 1, 0)
    assert "robot_map" not in state_to_json(plain)
    document = state_to_json(replace(plain, robot_map=small_map().figures))["robot_map"]
    assert (1, 24) == (document["degree"], document["points"])
    assert [-100.0, -90.0, 140.0] == document["least_mm"]
    schema = load_schema()
    stated = schema["$defs"]["state_message"]["properties"]["robot_map"]
    assert [] == violations(document, stated, schema)
    assert set(document) == set(stated["properties"])
