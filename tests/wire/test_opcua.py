"""OPC UA with a live cell, by asyncua's, python-opcua's and open62541's clients."""

from __future__ import annotations

import asyncio
import inspect
import json
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from dataclasses import replace
from ipaddress import ip_network
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from helpers.opcuacell import JOBS, PASSWORD, OpcUaCell, client_of, make_certificate, secure_settings
from helpers.ports import answers, free_port
from helpers.smallcell import DaemonProcess, SmallCell
from helpers.snapshots import make_target
from helpers.waiting import LIMIT_S, WHOLE_S
from pymodbus.client import ModbusTcpClient

from edged.adapters.modbus import ModbusSettings
from edged.adapters.opcua import OpcUaPublisher, OpcUaSettings, identity_of
from edged.adapters.opcua.model import read_model
from edged.adapters.opcua.picture import RegisterPicture
from edged.adapters.opcua.server import ServerThread
from edged.domain.measurement import Reject
from edged.errors import ListenError
from edged.plc import registers as reg
from edged.plc.answers import NackReason

VISION, CELL = 2, 3
SYSTEM = "ns=3;s=VisionSystem"
MACHINE = f"{SYSTEM}.VisionStateMachine"
AUTOMATIC = f"{MACHINE}.AutomaticModeStateMachine"
RECIPES = f"{SYSTEM}.RecipeManagement"
RESULTS = f"{SYSTEM}.ResultManagement"
X = "ns=3;s=Registers.result.X"
NO_DATA = ua.StatusCodes.BadNoData
U16, U32, I32, DOUBLE = (getattr(ua.VariantType, name) for name in ("UInt16", "UInt32", "Int32", "Double"))


@pytest.fixture(scope="module")
def secure(tmp_path_factory: pytest.TempPathFactory) -> OpcUaSettings:
    """Settings with certificates; the client `friend` is trusted."""
    return secure_settings(tmp_path_factory.mktemp("opcua"))


@pytest.fixture
def cell(secure: OpcUaSettings) -> Iterator[OpcUaCell]:
    """A cell that requires a certificate and the password."""
    with OpcUaCell(secure) as running:
        yield running


@pytest.fixture(scope="module")
def open_cell() -> Iterator[OpcUaCell]:
    """A cell that anyone may read and no one may command."""
    with OpcUaCell(OpcUaSettings("cell1", port=0, anonymous=True)) as running:
        yield running


@asynccontextmanager
async def connected(
    cell: OpcUaCell,
    secure: OpcUaSettings,
    *,
    name: str = "friend",
    user: str = "operator",
    password: str = PASSWORD,
) -> AsyncIterator[Client]:
    """A client with its certificate and password."""
    folder = secure.certificate.parent if secure.certificate is not None else Path()
    client = client_of(cell.url)
    client.application_uri = f"urn:test:{name}"
    await client.set_security(
        SecurityPolicyBasic256Sha256,
        certificate=str(folder / f"{name}.der"),
        private_key=str(folder / f"{name}.key.der"),
        server_certificate=str(folder / "server.pem"),
    )
    if user:
        client.set_user(user)
        client.set_password(password)
    async with client:
        yield client


class Notes:
    """Notifications of a subscription."""

    def __init__(self) -> None:
        self.changes: list[tuple[str, Any, int]] = []
        self.events: list[Any] = []

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        """Note a value."""
        got = data.monitored_item.Value
        self.changes.append((node.nodeid.Identifier.rpartition(".")[2], value, got.StatusCode.value))

    def event_notification(self, event: Any) -> None:
        """Note an event."""
        self.events.append(event)

    def types(self) -> list[int]:
        """Type numbers of the events."""
        return [event.EventType.Identifier for event in self.events]


async def until(holds: Callable[[], Any], seconds: float = LIMIT_S) -> None:
    """Wait until the condition holds; fail after the time."""
    async with asyncio.timeout(seconds):
        while True:
            found = holds()
            if await found if inspect.isawaitable(found) else found:
                return
            await asyncio.sleep(0.01)


async def events_of(client: Client) -> Notes:
    """Subscribe to all events of the vision system."""
    notes = Notes()
    subscription = await client.create_subscription(20, notes)
    kinds = [
        client.get_node(ua.NodeId(number, VISION))
        for number in (1013, 1018, 1019, 1020, 1022, 1023, 1024, 1025)
    ]
    await subscription.subscribe_events(client.get_node(SYSTEM), kinds)
    return notes


async def start(client: Client, recipe: str = "") -> tuple[str, int]:
    """Call StartSingleJob; returns its JobId and Error."""
    job, error = await client.get_node(AUTOMATIC).call_method(
        "2:StartSingleJob",
        ua.MeasIdDataType(Id="measurement 1"),
        ua.PartIdDataType(Id="part 7"),
        ua.RecipeIdExternalDataType(Id=recipe),
        ua.ProductIdDataType(),
        ua.Variant([], ua.VariantType.Variant, is_array=True),
    )
    return job.Id, error


async def command(client: Client, kind: int, job: int = 0, flange: tuple[float, ...] = ()) -> tuple[int, int]:
    """Call the cell's own command method."""
    sequence, error = await client.get_node("ns=3;s=Handshake").call_method(
        "3:Command",
        ua.Variant(kind, U16),
        ua.Variant(job, U16),
        ua.Variant(list(flange), DOUBLE, is_array=True),
        ua.Variant(0, U16),
    )
    return sequence, error


async def register(client: Client, block: str, name: str) -> Any:
    """Value of a register; None if it has none."""
    data = await client.get_node(f"ns=3;s=Registers.{block}.{name}").read_data_value(
        raise_on_bad_status=False
    )
    return data.Value.Value if data.StatusCode.is_good() else None


async def has_x(client: Client) -> bool:
    """Whether a coordinate is shown."""
    return await register(client, "result", "X") is not None


async def has_no_x(client: Client) -> bool:
    """Whether no coordinate is shown."""
    return not await has_x(client)


async def nobody_owns(client: Client) -> bool:
    """Whether the right to write is free."""
    return not await register(client, "status", "WRITE_OWNER")


# --- the address space --------------------------------------------------------------------------


@pytest.mark.slow
def test_the_table_has_every_type_of_the_specification_and_each_number_once() -> None:
    """The table has the 35 object, 1 variable, 22 data and 2 reference types of OPC 40100-1."""
    rows = read_model().rows
    kinds = [row.kind for row in rows]

    assert len(rows) == len({row.number for row in rows})
    assert [35, 1, 22, 2] == [kinds.count(kind) for kind in ("OT", "VT", "DT", "RT")]


@pytest.mark.slow
async def test_every_mandatory_part_of_the_vision_system_is_there(open_cell: OpcUaCell) -> None:
    """Each node has the specification's type and all mandatory children of that type."""
    model = read_model()
    expected = {
        SYSTEM: 1003,
        MACHINE: 1017,
        AUTOMATIC: 1021,
        RECIPES: 1004,
        f"{RECIPES}.Recipes": 1008,
        f"{RECIPES}.Recipes.job1": 1002,
        RESULTS: 1007,
    }
    async with client_of(open_cell.url) as client:
        for path, number in expected.items():
            node = client.get_node(path)
            names = {(await child.read_browse_name()).Name for child in await node.get_children()}
            rows = [row for row in model.children[f"1:{number}"] if row.rule == "M"]
            assert number == (await node.read_type_definition()).Identifier, path
            assert set() == {row.name.removeprefix("0:") for row in rows} - names, path


@pytest.mark.slow
async def test_every_register_is_a_variable_with_its_number_and_unit(open_cell: OpcUaCell) -> None:
    """The variables equal the Modbus registers, and those that stand for no number are BadNoData."""
    async with client_of(open_cell.url) as client:
        names = [(block.name, register) for block in reg.BLOCKS for register in block.registers]
        nodes = [client.get_node(f"ns=3;s=Registers.{block}.{register.name}") for block, register in names]
        ids = [ua.ReadValueId(NodeId=node.nodeid, AttributeId=ua.AttributeIds.Value) for node in nodes]
        data = await client.uaclient.read(ua.ReadParameters(NodesToRead=ids))
        expected = {one.address: value for one, value in open_cell.call(open_cell.server.values)}
        changing = {"HEARTBEAT", "UR_HEARTBEAT", "RESULT_AGE"}
        for (block, one), got in zip(names, data, strict=True):
            if got.StatusCode.is_good() and one.name not in changing and not one.name.endswith("CRC16"):
                assert expected.get(one.address, 0) == pytest.approx(got.Value.Value), (block, one.name)
        bad = {one.name for (_, one), got in zip(names, data, strict=True) if not got.StatusCode.is_good()}
        assert {"X", "F_X", "SIGMA_X", "G_SIGMA_X", "T0_X", "UR_X", "G_X", "UG_X"} <= bad
        assert "RESULT" not in bad
        unit = await client.get_node("ns=3;s=Registers.float.F_X.EngineeringUnits").read_value()
        assert ("mm", 5066068) == (unit.DisplayName.Text, unit.UnitId)  # OPC 10000-8, table 78: MMT


@pytest.mark.slow
async def test_a_job_is_a_recipe_and_comes_and_goes_with_the_configuration(open_cell: OpcUaCell) -> None:
    """After a reload with other jobs, the folder has those recipes with their methods."""

    async def names(client: Client) -> set[str]:
        children = await client.get_node(f"{RECIPES}.Recipes").get_children()
        return {(await child.read_browse_name()).Name for child in children}

    async def has_jobs(client: Client, expected: set[str]) -> bool:
        try:
            return await names(client) == expected
        except ua.uaerrors.BadNodeIdUnknown:  # removed between listing and reading its name
            return False

    async with client_of(open_cell.url) as client:
        assert {"job1", "job2"} == await names(client)
        internal = await client.get_node(f"{RECIPES}.Recipes.job2.InternalId").read_value()
        open_cell.call(lambda: open_cell.jobs.__setitem__(1, (3, "job3")))
        await until(lambda: has_jobs(client, {"job1", "job3"}))
        assert "job2" == internal.Id
        with pytest.raises(ua.uaerrors.BadNotSupported):
            await client.get_node(f"{RECIPES}.Recipes.job3").call_method("2:Unprepare")


# --- one command, one result -------------------------------------------------------------------


@pytest.mark.slow
async def test_a_single_job_ends_in_one_result_with_the_numbers_of_the_payload(
    cell: OpcUaCell, secure: OpcUaSettings
) -> None:
    """JobStarted, ResultReady and Ready carry the job's id, and the content is the payload message."""
    async with connected(cell, secure) as client:
        notes = await events_of(client)
        job, error = await start(client)
        assert 0 == error
        await until(lambda: {1013, 1023, 1024, 1025} <= set(notes.types()))
        (ready,) = [event for event in notes.events if event.EventType.Identifier == 1024]
        (content,) = ready.ResultContent
        payload = json.loads(content.Value if isinstance(content, ua.Variant) else content)
        target = payload["targets"][0]
        assert (job, "measurement 1", "part 7") == (ready.JobId.Id, ready.MeasId.Id, ready.PartId.Id)
        assert ("job1", 1) == (ready.InternalRecipeId.Id, ready.ResultState)
        assert 3 == len(target["pose_robot"]["sigma_mm"])
        x_mm = await register(client, "float", "F_X")
        assert target["pose_robot"]["position_mm"][0] == pytest.approx(x_mm, abs=1e-3)
        handle, data, error = await client.get_node(RESULTS).call_method(
            "2:GetResultById", ready.ResultId, ua.Variant(0, I32)
        )
        assert (0, 0, job) == (handle, error, data.JobId.Id)
        assert 1 == cell.head.captures


@pytest.mark.slow
async def test_an_acknowledged_result_falls_everywhere_in_one_write(
    cell: OpcUaCell, secure: OpcUaSettings
) -> None:
    """Coordinates, latest result and its flag lose their values with BadNoData, in one notification."""
    async with connected(cell, secure) as client:
        sequence, _ = await command(client, 1)
        latest = client.get_node(f"{RESULTS}.Results.Latest")
        await until(lambda: has_x(client))
        assert sequence == await register(client, "result", "SEQ_HEAD")
        notes = Notes()
        subscription = await client.create_subscription(20, notes)
        await subscription.subscribe_data_change([client.get_node(X), latest])
        await until(lambda: len(notes.changes) == 2)
        (error,) = [
            await client.get_node("ns=3;s=Handshake").call_method("3:Acknowledge", ua.Variant(sequence, U16))
        ]
        await until(lambda: len(notes.changes) == 4)
        assert 0 == error
        assert [("X", NO_DATA), ("Latest", NO_DATA)] == [(name, code) for name, _, code in notes.changes[2:]]
        bits = await register(client, "status", "STATUS_BITS")
        assert not bits & reg.StatusBit.RESULT_VALID
        # what is independent of a result stays
        assert 0 == await register(client, "reference marks", "M_STATE")
        assert reg.INT32_MIN == await register(client, "acceptance", "A_DAYS")
        _, data, error = await client.get_node(RESULTS).call_method(
            "2:GetResultById", ua.ResultIdDataType(), ua.Variant(0, I32)
        )
        assert (0, -110) == (data.ResultState, error)


@pytest.mark.slow
async def test_no_value_that_has_fallen_waits_in_a_slow_subscription(
    cell: OpcUaCell, secure: OpcUaSettings
) -> None:
    """A value that was valid between two notifications is reported as BadNoData, without its coordinate."""
    async with connected(cell, secure) as client:
        notes = Notes()
        subscription = await client.create_subscription(1000, notes)
        await subscription.subscribe_data_change(client.get_node(X), queuesize=10)
        await until(lambda: notes.changes)
        sequence, _ = await command(client, 1)
        await until(lambda: has_x(client))
        await client.get_node("ns=3;s=Handshake").call_method("3:Acknowledge", ua.Variant(sequence, U16))
        await until(lambda: len(notes.changes) > 1)
    assert {NO_DATA} == {code for _, _, code in notes.changes}


@pytest.mark.long
async def test_a_result_that_grows_old_falls_without_anybody_doing_anything(secure: OpcUaSettings) -> None:
    """After validity_s no read gives a coordinate, and subscribers are notified without any request."""
    with OpcUaCell(secure, ModbusSettings(port=0, validity_s=0.4)) as cell:
        async with connected(cell, secure) as client:
            notes = Notes()
            subscription = await client.create_subscription(20, notes)
            await subscription.subscribe_data_change(client.get_node(X))
            await command(client, 1)
            await until(lambda: len(notes.changes) == 3)
            assert await register(client, "result", "X") is None
            # hidden with the result until the cell's next picture
            while (bits := await register(client, "status", "STATUS_BITS")) is None:
                pass
            assert not bits & reg.StatusBit.RESULT_VALID
        changes = notes.changes

    assert [NO_DATA, 0, NO_DATA] == [code for _, _, code in changes]


@pytest.mark.long
async def test_a_result_whose_time_is_over_is_not_shown_though_the_cell_is_busy_elsewhere(
    secure: OpcUaSettings,
) -> None:
    """The server's thread withdraws the result itself, while the cell's loop is blocked."""
    with OpcUaCell(secure, ModbusSettings(port=0, validity_s=0.5)) as cell:
        async with connected(cell, secure) as client:
            await command(client, 1)
            await until(lambda: has_x(client))
            done, blocks = asyncio.Event(), asyncio.get_running_loop()

            def block() -> None:
                time.sleep(1.5)
                blocks.call_soon_threadsafe(done.set)

            cell.loop.call_soon_threadsafe(block)
            await until(lambda: has_no_x(client))
            assert not done.is_set()
            await done.wait()


@pytest.mark.long
def test_no_read_sees_halves_of_two_results(secure: OpcUaSettings) -> None:
    """In a constantly measuring cell, head, tail and every block's sequence of one read belong together."""
    names = [
        ("result", "SEQ_HEAD"),
        ("result", "SEQ_TAIL"),
        ("ur", "UR_SEQ_HEAD"),
        ("float", "F_SEQ_TAIL"),
        ("target 0", "T0_SEQ"),
    ]

    async def run(cell: OpcUaCell) -> list[tuple[int, ...]]:
        seen = []
        async with connected(cell, secure) as client:
            nodes = [client.get_node(f"ns=3;s=Registers.{block}.{name}") for block, name in names]
            while len({one[0] for one in seen}) < 20:
                seen.append(tuple(await client.read_values(nodes)))
        return seen

    with OpcUaCell(secure, period_s=0.01) as cell:
        seen = asyncio.run(run(cell))

    assert [] == [one for one in seen if len(set(one)) != 1]


@pytest.mark.slow
async def test_a_part_that_no_robot_may_use_has_a_result_and_no_coordinate(
    cell: OpcUaCell, secure: OpcUaSettings
) -> None:
    """A rejected part gives a result without targets in its content, and no coordinate."""
    async with connected(cell, secure) as client:
        cell.targets = (make_target(Reject.RESIDUAL),)
        notes = await events_of(client)
        await start(client)
        await until(lambda: 1024 in notes.types())
        (ready,) = [event for event in notes.events if event.EventType.Identifier == 1024]
        (content,) = ready.ResultContent
        assert [] == json.loads(content.Value if isinstance(content, ua.Variant) else content)["targets"]
        assert await register(client, "result", "X") is None


@pytest.mark.long
async def test_verify_gives_no_coordinates_also_not_in_the_content(
    cell: OpcUaCell, secure: OpcUaSettings
) -> None:
    """The result has no content and no coordinate, and the status is OK."""
    async with connected(cell, secure) as client:
        notes = await events_of(client)
        await command(client, 4)
        await until(lambda: 1024 in notes.types())
        (ready,) = [event for event in notes.events if event.EventType.Identifier == 1024]
        assert not ready.ResultContent
        assert await register(client, "status", "STATUS_BITS") & reg.StatusBit.OK


@pytest.mark.long
@pytest.mark.parametrize("is_seldom_shown", [False, True])
async def test_a_recipe_is_prepared_by_the_handshakes_job_change(
    cell: OpcUaCell, secure: OpcUaSettings, monkeypatch: pytest.MonkeyPatch, is_seldom_shown: bool
) -> None:
    """Preparing leaves Ready, is not completed at once, and ends with RecipePrepared and Ready; a loaded
    recipe needs none. An unknown one is refused.
    """
    if is_seldom_shown:  # the job changes between two pictures
        post, last_s = ServerThread.post, time.monotonic()

        def seldom(server: ServerThread, picture: RegisterPicture) -> None:
            nonlocal last_s
            if time.monotonic() - last_s > 1.0:
                last_s = time.monotonic()
                post(server, picture)

        monkeypatch.setattr(ServerThread, "post", seldom)
    async with connected(cell, secure) as client:
        notes = await events_of(client)
        empty = ua.RecipeIdExternalDataType()
        first = await client.get_node(RECIPES).call_method(
            "2:PrepareRecipe", empty, ua.RecipeIdInternalDataType(Id="job2")
        )
        await until(lambda: 1022 in notes.types())
        second = await client.get_node(f"{RECIPES}.Recipes.job2").call_method("2:Prepare")
        unknown = await client.get_node(RECIPES).call_method(
            "2:PrepareRecipe", ua.RecipeIdExternalDataType(Id="job9"), ua.RecipeIdInternalDataType()
        )
        await until(lambda: [1018, 1018] == [kind for kind in notes.types() if kind == 1018])
        transitions = [event.Transition.Text for event in notes.events if event.EventType.Identifier == 1018]
        assert ["ReadyToInitializedRecipe", "InitializedToReadyRecipe"] == transitions
        assert ("job2", False, 0) == (first[0].Id, *first[1:])
        assert [True, 0] == second
        assert [False, -int(NackReason.REFUSED)] == unknown[1:]
        assert 2 == await register(client, "status", "ACTIVE_JOB")
        assert await client.get_node(f"{RECIPES}.Recipes.job2.IsPrepared").read_value()


@pytest.mark.slow
async def test_a_camera_that_fails_is_a_failed_result_and_the_state_error(
    cell: OpcUaCell, secure: OpcUaSettings
) -> None:
    """The result is a CAPTURE_FAULT with state Error, which is left when the camera works again."""
    async with connected(cell, secure) as client:
        notes = await events_of(client)
        cell.head.broken = True
        await start(client)
        await until(lambda: {1019, 1024} <= set(notes.types()))
        (result,) = [event for event in notes.events if event.EventType.Identifier == 1024]
        state = await client.get_node(f"{MACHINE}.CurrentState").read_value()
        inner = await client.get_node(f"{AUTOMATIC}.CurrentState").read_data_value(raise_on_bad_status=False)
        with pytest.raises(ua.uaerrors.BadInvalidState):
            await start(client)
        cell.head.broken = False
        await until(lambda: 1020 in notes.types())
        assert (4, "Error") == (result.ResultState, state.Text)
        assert ua.StatusCodes.BadStateNotActive == inner.StatusCode.value


@pytest.mark.slow
async def test_a_job_that_does_not_exist_runs_nothing(cell: OpcUaCell, secure: OpcUaSettings) -> None:
    """Both the specification's and the cell's method are refused as over Modbus, and nothing runs."""
    async with connected(cell, secure) as client:
        assert ("", -int(NackReason.REFUSED)) == await start(client, "job9")
        assert -int(NackReason.REFUSED) == (await command(client, 1, 9))[1]
        assert -int(NackReason.UNKNOWN_COMMAND) == (await command(client, 77))[1]
    assert 0 == cell.head.captures


@pytest.mark.slow
async def test_only_one_client_commands_at_a_time_whatever_it_speaks(
    cell: OpcUaCell, secure: OpcUaSettings
) -> None:
    """While a PLC holds the right to write, a method answers Error -114, and the other way round."""
    plc = ModbusTcpClient("127.0.0.1", port=cell.port)
    async with connected(cell, secure) as client:
        await asyncio.to_thread(plc.connect)
        await asyncio.to_thread(plc.write_register, reg.ADDRESS["JOB"], 1)
        assert -114 == (await start(client))[1]
        await asyncio.to_thread(plc.write_register, reg.ADDRESS["OPTIONS"], int(reg.Option.RELEASE))
        assert 0 == (await start(client))[1]
        refused = await asyncio.to_thread(plc.write_register, reg.ADDRESS["JOB"], 1)
        assert 6 == refused.exception_code
        await until(lambda: cell.head.captures == 1)
        await client.get_node("ns=3;s=Handshake").call_method("3:Release")
        notes = await events_of(client)
        for sequence in (8, 9):  # the first of a connection runs nothing
            words = [1, 1, sequence]
            taken = await asyncio.to_thread(plc.write_registers, reg.ADDRESS["COMMAND"], words)
            assert not taken.isError()
        await until(lambda: 1024 in notes.types())
        begun = next(event for event in notes.events if event.EventType.Identifier == 1018)
        assert "ReadyToSingleExecutionAuto" == begun.Transition.Text  # caused by no method
    plc.close()


@pytest.mark.slow
async def test_who_hangs_up_gives_up_its_right_to_write(cell: OpcUaCell, secure: OpcUaSettings) -> None:
    """After a client disconnects, no one owns the right to write."""
    async with connected(cell, secure) as client:
        await command(client, 3)
        assert 1 == await register(client, "status", "WRITE_OWNER")
        await until(lambda: cell.head.captures == 1)
    async with connected(cell, secure) as client:
        await until(lambda: nobody_owns(client), 3)


@pytest.mark.slow
async def test_what_a_cell_cannot_do_is_said(cell: OpcUaCell, secure: OpcUaSettings) -> None:
    """Unsupported methods answer BadNotSupported; missing and invalid arguments are errors, too."""
    cause = (ua.Variant(0, I32), ua.Variant("", ua.VariantType.String))
    async with connected(cell, secure) as client:
        for path, name in (
            (MACHINE, "Reset"),
            (MACHINE, "Halt"),
            (AUTOMATIC, "Stop"),
            (AUTOMATIC, "Abort"),
            (AUTOMATIC, "StartContinuous"),
            (RECIPES, "UnprepareRecipe"),
        ):
            with pytest.raises(ua.uaerrors.BadNotSupported):
                await client.get_node(path).call_method(f"2:{name}", *cause)
        assert 0 == await client.get_node(MACHINE).call_method("2:SelectModeAutomatic")
        with pytest.raises(ua.uaerrors.BadArgumentsMissing):
            await client.get_node(AUTOMATIC).call_method("2:StartSingleJob")
        with pytest.raises(ua.uaerrors.BadInvalidArgument):
            await command(client, 1, 0, (1.0, 2.0))


# --- access --------------------------------------------------------------------------------------


@pytest.mark.slow
async def test_without_certificate_nothing_can_be_read_unless_it_is_allowed(
    cell: OpcUaCell, secure: OpcUaSettings
) -> None:
    """The endpoints, all encrypted, can be listed, but no session can be opened."""
    client = client_of(cell.url)
    endpoints = await client.connect_and_get_server_endpoints()
    assert {ua.MessageSecurityMode.SignAndEncrypt} == {one.SecurityMode for one in endpoints}
    with pytest.raises(ua.UaError):
        async with client_of(cell.url):
            pass


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "user", "password"),
    [
        ("friend", "operator", "a wrong password"),
        ("friend", "root", PASSWORD),
        ("friend", "", ""),
        ("stranger", "operator", PASSWORD),
        ("expired", "operator", PASSWORD),
    ],
)
async def test_a_wrong_password_no_user_and_a_strange_certificate_are_refused(
    name: str, user: str, password: str, cell: OpcUaCell, secure: OpcUaSettings
) -> None:
    """Certificate, user and password must all be right."""
    with pytest.raises((ua.UaError, ConnectionError, TimeoutError)):
        async with connected(cell, secure, name=name, user=user, password=password):
            pass

    assert 0 == cell.head.captures


@pytest.mark.slow
async def test_a_strange_certificate_is_kept_so_that_it_can_be_trusted(
    cell: OpcUaCell, secure: OpcUaSettings
) -> None:
    """The refused certificate is saved unchanged in a folder beside the trusted ones."""
    assert secure.trusted is not None
    folder = secure.trusted.parent
    with pytest.raises((ua.UaError, ConnectionError, TimeoutError)):
        async with connected(cell, secure, name="stranger"):
            pass

    kept = [file.read_bytes() for file in (folder / "rejected").iterdir()]
    assert (folder / "stranger.der").read_bytes() in kept


@pytest.mark.long
async def test_who_is_anonymous_may_look_and_not_command(secure: OpcUaSettings) -> None:
    """Reading is allowed but commands are not, also on an encrypted channel; passwords need encryption."""
    with OpcUaCell(replace(secure, anonymous=True)) as cell:
        async with client_of(cell.url) as client:
            assert 1 == await register(client, "status", "ACTIVE_JOB")
            for call in (start(client), command(client, 1)):
                with pytest.raises(ua.uaerrors.BadUserAccessDenied):
                    await call
            with pytest.raises(ua.uaerrors.BadServiceUnsupported):
                await client.get_node("ns=3;s=Registers.command.JOB").write_value(ua.Variant(2, U16))
        async with connected(cell, secure, user="") as client:
            with pytest.raises(ua.uaerrors.BadUserAccessDenied):
                await start(client)
        plain = client_of(cell.url)
        plain.set_user("operator")
        plain.set_password(PASSWORD)
        with pytest.raises(ua.uaerrors.BadUserAccessDenied):
            async with plain:
                pass
        assert 0 == cell.head.captures


@pytest.mark.slow
async def test_a_client_reaches_its_own_subscriptions_only(open_cell: OpcUaCell) -> None:
    """A client cannot delete or change another's subscription, though asyncua numbers them in one
    sequence."""
    notes = Notes()
    async with client_of(open_cell.url) as one, client_of(open_cell.url) as other:
        subscription = await one.create_subscription(20, notes)
        await subscription.subscribe_data_change(one.get_node("ns=3;s=Registers.status.HEARTBEAT"))
        number = subscription.subscription_id
        for attempt in (
            other.uaclient.delete_subscriptions([number]),
            other.uaclient.set_publishing_mode(
                ua.SetPublishingModeParameters(PublishingEnabled=False, SubscriptionIds=[number])
            ),
        ):
            with pytest.raises(ua.uaerrors.BadSubscriptionIdInvalid):
                await attempt
        seen = len(notes.changes)
        await until(lambda: len(notes.changes) > seen + 3)


@pytest.mark.slow
async def test_a_network_that_is_not_listed_is_not_let_in(secure: OpcUaSettings) -> None:
    """Its connection is closed without an answer."""
    with OpcUaCell(replace(secure, readers=(ip_network("10.0.0.0/8"),))) as cell:
        reader, writer = await asyncio.open_connection("127.0.0.1", cell.publisher.port)
        with pytest.raises(ConnectionError):
            try:
                data = await reader.read()
            finally:
                writer.close()
            if data == b"":
                raise ConnectionResetError
        assert b"" == data


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"key": "friend.key"}, "certificate that belongs to it"),
        ({"certificate": "friend.pem", "key": "friend.key"}, "URI:urn:edged:cell1"),
        ({"certificate": "missing.pem"}, "No such file"),
        ({"key": "server.pem"}, "PEM files"),
    ],
)
def test_files_that_do_not_fit_are_named(
    change: dict[str, str], expected: str, secure: OpcUaSettings
) -> None:
    """The error names the problem, before anything listens."""
    assert secure.certificate is not None
    folder = secure.certificate.parent
    wrong = replace(secure, **{name: folder / file for name, file in change.items()})

    with pytest.raises(ListenError, match=expected):
        identity_of(wrong)


@pytest.mark.slow
async def test_a_port_that_is_taken_is_a_listen_error_and_leaves_nothing(open_cell: OpcUaCell) -> None:
    """The error is raised, and no thread or socket is left."""
    settings = OpcUaSettings("cell1", port=open_cell.publisher.port, anonymous=True)
    publisher = OpcUaPublisher(settings, lambda: None, lambda: JOBS)
    with pytest.raises(ListenError, match="cannot listen"):
        await publisher.start()
    await publisher.close()


# --- another client --------------------------------------------------------------------------------

OTHER_CLIENT = """
import json, sys, time
from opcua import Client, ua
from opcua.crypto.security_policies import SecurityPolicyBasic256Sha256
url, folder, password = sys.argv[1:]
client = Client(url, timeout=60)
client.application_uri = "urn:test:friend"
client.set_security(SecurityPolicyBasic256Sha256, f"{folder}/friend.der", f"{folder}/friend.key.der",
    f"{folder}/server.der", ua.MessageSecurityMode.SignAndEncrypt)
client.set_user("operator")
client.set_password(password)
with client:
    read = lambda node: client.get_node(node).get_value()
    path = "ns=3;s=VisionSystem.VisionStateMachine"
    said = {"state": read(path + ".CurrentState").Text,
        "automatic": read(path + ".AutomaticModeStateMachine.CurrentState").Text}
    handshake, command = client.get_node("ns=3;s=Handshake"), client.get_node("ns=3;s=Handshake.Command")
    number = lambda value: ua.Variant(value, ua.VariantType.UInt16)
    arguments = [number(1), number(0), ua.Variant([0.0] * 6, ua.VariantType.Double), number(0)]
    said["answer"] = handshake.call_method(command.nodeid, *arguments)
    end = time.monotonic() + 10
    while time.monotonic() < end:
        try:
            said["x_mm"] = read("ns=3;s=Registers.float.F_X")
            break
        except ua.UaStatusCodeError as error:
            said["before"] = str(error)
            time.sleep(0.01)
    uris = client.get_namespace_array()
    job = read("ns=3;s=VisionSystem.RecipeManagement.Recipes.job1.InternalId")
    result = read("ns=3;s=VisionSystem.ResultManagement.Results.Latest")
    for name, one in (("job", job), ("result", result)):
        said[name] = [uris[one.TypeId.NamespaceIndex], one.TypeId.Identifier, one.Body.hex()]
print(json.dumps(said))
"""


def client_process(program: str, cell: OpcUaCell, secure: OpcUaSettings) -> dict[str, Any]:
    """Output of a client in a process of its own, so that its deprecation warnings are not ours."""
    assert secure.certificate is not None
    done = subprocess.run(
        [sys.executable, "-c", program, cell.url, str(secure.certificate.parent), PASSWORD],
        capture_output=True,
        text=True,
        timeout=WHOLE_S,
        check=False,
    )
    assert 0 == done.returncode, done.stderr[-2000:]
    said: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return said


@pytest.mark.slow
def test_another_client_commands_and_reads(cell: OpcUaCell, secure: OpcUaSettings) -> None:
    """python-opcua, encrypted; structures arrive under the specification's ids, in OPC UA's binary encoding.

    asyncua began as a copy of it: what both may get wrong alike is compared with the specification's bytes.
    """
    said = client_process(OTHER_CLIENT, cell, secure)

    assert ("Operational", "Ready") == (said["state"], said["automatic"])
    values = {register.name: value for register, value in cell.call(cell.server.values)}
    assert values["F_X"] == pytest.approx(said["x_mm"])
    assert [said["answer"][0], 0] == said["answer"]
    # a mask of the optional fields, the length of a text, the text (OPC 10000-6, 5.2.2.4 and 5.2.7)
    machine_vision = "http://opcfoundation.org/UA/MachineVision"
    body = (b"\0\0\0\0" + b"\4\0\0\0" + b"job1").hex()
    assert [machine_vision, 5268, body] == said["job"]
    assert [machine_vision, 5018] == said["result"][:2]
    assert f"{values['START_EPOCH']}-{values['SEQ_HEAD']}".encode().hex() in said["result"][2]


FOREIGN_CLIENT = """
import json, sys, time
import o6
from o6.ns import ns0
url, folder, password = sys.argv[1:]
SYSTEM = "ns=3;s=VisionSystem"
AUTOMATIC = SYSTEM + ".VisionStateMachine.AutomaticModeStateMachine"
said, events = {}, []

def connected():
    return o6.Client(url, certificate=folder + "/friend.der", privateKey=folder + "/friend.key.der",
        trustList=[folder + "/server.der"], securityMode=3, applicationUri="urn:test:friend",
        securityPolicy="http://opcfoundation.org/UA/SecurityPolicy#Basic256Sha256", username="operator",
        password=password)

def clause(kind, *path):
    found = ns0.datatypes.SimpleAttributeOperand()
    found.typeDefinitionId, found.attributeId = o6.NodeId(kind), o6.AttributeId.VALUE
    found.browsePath = [o6.QualifiedName(name) for name in path]
    return found

with connected() as client:
    kinds = {str(kind["typeId"]): kind for kind in client.getRemoteDataTypes()}
    own = [kind for number, kind in kinds.items() if number.startswith("ns=machine_vision;")]
    said["encodings"] = {kind["typeName"]: str(kind["binaryEncodingId"]) for kind in own}
    said["unknown"] = str(client.read(SYSTEM + ".RecipeManagement.Recipes.job1.InternalId").typeId)
    said["namespaces"] = []
    for metadata in client.browse("i=11715"):
        parts = {str(part.browseName): client.read(part.nodeId) for part in client.browse(metadata.nodeId)}
        kinds = [int(kind) for kind in parts["StaticNodeIdTypes"]]
        said["namespaces"].append([str(parts["NamespaceUri"]), kinds])

from o6.ns import machine_vision  # as its makers compiled it from the specification's own file
types = machine_vision.datatypes
with connected() as client:
    wanted = ns0.datatypes.EventFilter()
    wanted.selectClauses = [clause("i=2311", "Transition"), clause("i=2041", "ns=machine_vision;JobId")]
    client.monitorEvent(SYSTEM, events.append, wanted)
    parts = [types.MeasIdDataType(id="m 1"), types.PartIdDataType(id="p 7"), types.RecipeIdExternalDataType()]
    answer = client.call(AUTOMATIC, AUTOMATIC + ".StartSingleJob", [*parts, types.ProductIdDataType(), None])
    said["answer"] = [int(answer[0]), str(answer[1].id), int(answer[2])]
    end = time.monotonic() + 20
    while time.monotonic() < end and sum("SingleExecutionToReady" in str(event) for event in events) < 1:
        time.sleep(0.05)
    values = [list(event.values()) for event in events]
    said["transitions"] = [transition.text for transition, _ in values if transition is not None]
    said["jobs"] = sorted({str(job.id) for _, job in values if job is not None})
    result = client.read(SYSTEM + ".ResultManagement.Results.Latest")
    ids = result.jobId, result.measId, result.partId, result.internalRecipeId
    said["result"] = [str(identifier.id) for identifier in ids]
    said["content"] = str(result.resultContent[0])
print(json.dumps(said))
"""


@pytest.mark.long
def test_a_stack_of_another_origin_reads_structures_commands_and_follows_the_states(
    cell: OpcUaCell, secure: OpcUaSettings
) -> None:
    """open62541, in C, decodes results and commands, with types compiled from the specification's file.

    It finds which type is sent under which id, and decodes the whole result; its own structures are
    understood; a good job ends by the transition that no method causes.
    """
    said = client_process(FOREIGN_CLIENT, cell, secure)

    encodings = said["encodings"]
    assert 17 == len(encodings)
    assert "i=0" not in set(encodings.values()) - {encodings["BinaryIdBaseDataType"]}
    assert encodings["RecipeIdInternalDataType"] == said["unknown"]
    own = [["http://opcfoundation.org/UA/MachineVision", [0]], ["urn:edged:cell", [1]]]  # IdType, OPC 10000-3
    assert own == said["namespaces"][1:]
    status, job, error = said["answer"]
    assert (0, 0, [job]) == (status, error, said["jobs"])
    assert ["ReadyToSingleExecution", "SingleExecutionToReadyAuto"] == said["transitions"]
    assert [job, "m 1", "p 7", "job1"] == said["result"]
    assert "OK" == json.loads(said["content"])["status"]


@pytest.fixture(autouse=True, scope="module")
def _expired(secure: OpcUaSettings) -> None:
    """A trusted certificate that has expired."""
    assert secure.certificate is not None
    assert secure.trusted is not None
    make_certificate(secure.certificate.parent, "expired", "urn:test:expired", days=-1)
    data = (secure.certificate.parent / "expired.der").read_bytes()
    (secure.trusted / "expired.der").write_bytes(data)


# --- a daemon --------------------------------------------------------------------------------------


@pytest.mark.long
async def test_a_daemon_serves_it_and_goes_on_when_a_reload_exchanges_the_registers(tmp_path: Path) -> None:
    """After Modbus moved to another port, the same OPC UA session shows the new registers and epoch."""
    small, port, modbus = SmallCell(tmp_path, period_s=0.5), free_port(), free_port()
    small.config.write_text(small.config.read_text() + f"\n[opcua]\nport = {port}\nanonymous = true\n")
    daemon = DaemonProcess(small.config)

    async def epoch(client: Client) -> int:
        return int(await register(client, "status", "START_EPOCH"))

    async def has_another(client: Client, before: int) -> bool:
        return await epoch(client) != before

    async def measures(client: Client) -> bool:
        state = await client.get_node(f"{AUTOMATIC}.CurrentState").read_value()
        return state is not None and state.Text == "ContinuousExecution" and await has_x(client)

    try:
        daemon.wait_ready()
        await until(lambda: asyncio.to_thread(answers, port), LIMIT_S)
        async with client_of(f"opc.tcp://127.0.0.1:{port}") as client:
            await until(lambda: measures(client), LIMIT_S)
            before = await epoch(client)
            text = small.config.read_text().replace(f"port = {small.modbus_port}", f"port = {modbus}")
            small.config.write_text(text)
            daemon.process.send_signal(signal.SIGHUP)
            await until(lambda: has_another(client, before), LIMIT_S)
            await until(lambda: measures(client), LIMIT_S)
    finally:
        daemon.stop()
