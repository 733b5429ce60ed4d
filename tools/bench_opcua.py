#!/usr/bin/env python3
"""Time from a command to its result over OPC UA and over Modbus, beside the duration of the cycle itself.

Run it with `tools/bench opcua`. A cell with a known cycle (`--vision-ms`) runs in a process of its own;
commands are sent one after another, and each answer is waited for: over Modbus and OPC UA by polling, over
OPC UA by the event ResultReady, signed and encrypted. Finally, what the server costs a cell: start and
memory.
"""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from benching import TESTS, bench_parser, finish
from helpers.opcuacell import PASSWORD
from pymodbus.client import ModbusTcpClient

from edged.plc import registers as reg

SERVER = """
import json, sys, time
from pathlib import Path
from helpers.livecell import LiveCell
def resident_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6
folder, vision_ms, opcua = sys.argv[1:]
if opcua == "yes":
    from helpers.opcuacell import OpcUaCell, secure_settings
    cell = OpcUaCell(secure_settings(Path(folder)))
else:
    cell = LiveCell()
cell.slow_s = float(vision_ms) / 1e3
start_s = time.monotonic()
with cell:
    port = cell.publisher.port if opcua == "yes" else 0
    print(json.dumps([cell.port, port, time.monotonic() - start_s, resident_mb()]), flush=True)
    sys.stdin.read()
"""


class Server:
    """The cell in its own process: modbus, opcua (ports), start_s, resident_mb."""

    def __init__(self, folder: str, vision_ms: float, *, opcua: bool) -> None:
        path = os.pathsep.join((str(TESTS), str(TESTS.parent)))
        self._process = subprocess.Popen(
            [sys.executable, "-c", SERVER, folder, str(vision_ms), "yes" if opcua else "no"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": path},
        )
        assert self._process.stdout is not None
        self.modbus, self.opcua, self.start_s, self.resident_mb = json.loads(self._process.stdout.readline())

    def stop(self) -> None:
        """Stop the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(30)


def over_modbus(server: Server, count: int) -> tuple[list[float], list[float]]:
    """Seconds from the write to the answer, and those of the cycle alone, as in LATENCY."""
    took, cycles = [], []
    status = next(one for one in reg.STATUS.registers if one.name == "DONE_SEQ").address
    with ModbusTcpClient("127.0.0.1", port=server.modbus) as plc:
        last = plc.read_holding_registers(reg.ADDRESS["LAST_SEQ"], count=1).registers[0]
        for number in range(count):
            sequence = (last + number) % 65535 + 1
            words = [1, 0, sequence, 0, 0, int(reg.Option.ONCE)]
            start_s = time.perf_counter()
            plc.write_registers(reg.COMMAND.address, words)
            while plc.read_holding_registers(status, count=1).registers[0] != sequence:
                pass
            took.append(time.perf_counter() - start_s)
            block = plc.read_holding_registers(reg.RESULT.address, count=reg.RESULT.words).registers
            cycles.append(float(reg.decode(reg.RESULT, block)["LATENCY"]) / 1e6)
        plc.write_register(reg.ADDRESS["OPTIONS"], int(reg.Option.RELEASE))
    return took, cycles


async def command(client: Client) -> int:
    """Call LOCATE; return its sequence number."""
    sequence, error = await client.get_node("ns=3;s=Handshake").call_method(
        "3:Command",
        *(ua.Variant(number, ua.VariantType.UInt16) for number in (1, 0)),
        ua.Variant([], ua.VariantType.Double, is_array=True),
        ua.Variant(0, ua.VariantType.UInt16),
    )
    if error:
        raise ValueError(f"error {error}")
    return int(sequence)


class Notes:
    """Records results as events report them."""

    def __init__(self) -> None:
        self.told = asyncio.Event()

    def event_notification(self, _event: object) -> None:
        """Handle ResultReady."""
        self.told.set()


async def over_opcua(server: Server, folder: Path, count: int) -> tuple[list[float], list[float]]:
    """Seconds from the call to the answer: by polling, and by the event."""
    client = Client(f"opc.tcp://127.0.0.1:{server.opcua}")
    client.application_uri = "urn:test:friend"
    await client.set_security(
        SecurityPolicyBasic256Sha256,
        certificate=str(folder / "friend.der"),
        private_key=str(folder / "friend.key.der"),
        server_certificate=str(folder / "server.pem"),
    )
    client.set_user("operator")
    client.set_password(PASSWORD)
    polled, told = [], []
    async with client:
        done = client.get_node("ns=3;s=Registers.status.DONE_SEQ")
        for _ in range(count):
            start_s = time.perf_counter()
            sequence = await command(client)
            while await done.read_value() != sequence:
                pass
            polled.append(time.perf_counter() - start_s)
        notes = Notes()
        subscription = await client.create_subscription(10, notes)
        kind = client.get_node(ua.NodeId(1024, 2))
        await subscription.subscribe_events(client.get_node("ns=3;s=VisionSystem"), kind)
        for _ in range(count):
            notes.told.clear()
            start_s = time.perf_counter()
            await command(client)
            await notes.told.wait()
            told.append(time.perf_counter() - start_s)
        await client.get_node("ns=3;s=Handshake").call_method("3:Release")
    return polled, told


def main() -> None:
    """Measure and print."""
    parser = bench_parser(__doc__)
    parser.add_argument("--count", type=int, default=300, help="commands on each way")
    parser.add_argument("--vision-ms", type=float, default=20.0, help="what the cell's vision takes")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        plain = Server(folder, options.vision_ms, opcua=False)
        alone, cycles = over_modbus(plain, options.count)
        plain.stop()
        server = Server(folder, options.vision_ms, opcua=True)
        beside, _ = over_modbus(server, options.count)
        polled, told = asyncio.run(over_opcua(server, Path(folder), options.count))
        server.stop()
    cycle_ms = float(np.median(cycles)) * 1e3
    print(f"cycle, exposure to publication: median {cycle_ms:.1f} ms; {options.count} commands on each way")
    print("| from the command to its result | p50 ms | p99 ms | times the cycle |")
    print("|---|---|---|---|")
    for name, seconds in (
        ("Modbus, no OPC UA in the cell", alone),
        ("Modbus, OPC UA beside it", beside),
        ("OPC UA, polled", polled),
        ("OPC UA, event ResultReady", told),
    ):
        half, most = np.percentile(np.array(seconds) * 1e3, [50, 99])
        print(f"| {name} | {half:.1f} | {most:.1f} | {half / cycle_ms:.2f} |")
    print(
        f"start {server.start_s - plain.start_s:.1f} s longer, "
        f"memory {plain.resident_mb:.0f} to {server.resident_mb:.0f} MB"
    )
    finish(options)


if __name__ == "__main__":
    main()
