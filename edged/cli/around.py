"""Commands that demonstrate a cell without hardware, and connect other programs to one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from edged.cli.options import JsonOption, screen

app = typer.Typer()


@app.command()
def demo(
    cycles: Annotated[int, typer.Option(min=0, help="stop after so many cycles; 0: until ctrl-C")] = 0,
    period_s: Annotated[
        float, typer.Option("--period", min=0, max=60, help="seconds from trigger to trigger")
    ] = 0.25,
    in_process: Annotated[
        bool, typer.Option("--in-process", help="cameras inside the process instead of GigE Vision over UDP")
    ] = False,
    modbus_port: Annotated[int, typer.Option(min=1, max=65535, help="Modbus/TCP port")] = 1502,
    zenoh_port: Annotated[int, typer.Option(min=1, max=65535, help="Zenoh TCP port")] = 7447,
    web_port: Annotated[
        int, typer.Option(min=0, max=65535, help="port of the status page; 0: no page")
    ] = 8080,
    folder: Annotated[
        Path | None, typer.Option(help="where rig, job and config go; default: a temporary folder")
    ] = None,
    as_json: JsonOption = False,
    brand: Annotated[
        str | None,
        typer.Option(help="open the robots' socket, with poses as this maker writes them: kuka, abb, ..."),
    ] = None,
    belt: Annotated[
        bool, typer.Option("--belt", help="parts on a belt of 200 mm/s, on cameras inside the process")
    ] = False,
    stage: Annotated[
        bool, typer.Option("--stage", help="without rig and job: set the cell up on its page, step by step")
    ] = False,
) -> None:
    """Run a virtual cell and the daemon on this machine; compare measured and true positions."""
    from edged.commands.demo import DemoOptions
    from edged.commands.demo import demo as command

    raise typer.Exit(
        command(
            DemoOptions(
                cycles,
                period_s,
                in_process,
                modbus_port,
                zenoh_port,
                web_port or None,
                folder,
                as_json,
                stage,
                brand.lower() if brand is not None else None,
                belt=belt,
            )
        )
    )


@app.command()
def sim(
    config: Annotated[
        Path | None, typer.Argument(help="take addresses, serial numbers and rig from this configuration")
    ] = None,
    images: Annotated[
        Path | None, typer.Option(help="show these pairs NAME_left.png, NAME_right.png, again and again")
    ] = None,
    pattern: Annotated[str, typer.Option(help="show a moving ramp of so many pixels, 640x480")] = "",
    left: Annotated[str, typer.Option(help="address of the left camera, or none; 127.0.0.2")] = "",
    right: Annotated[str, typer.Option(help="address of the right camera, or none; 127.0.0.3")] = "",
    fault: Annotated[
        list[str] | None, typer.Option(help="packet_loss=0.01, right.frozen=on, ...; more by `help` on stdin")
    ] = None,
    quirk: Annotated[
        list[str] | None, typer.Option(help="habit of the firmware: mode-before-source, few-nodes, ...")
    ] = None,
    pulse_hz: Annotated[float, typer.Option("--pulse", min=0, max=1000, help="Hz: pulses on Line1")] = 0.0,
    drift_ppm: Annotated[
        float, typer.Option("--drift", min=-100_000, max=100_000, help="ppm: the right camera's clock")
    ] = 0.0,
    marks: Annotated[
        str, typer.Option(help="reference marks around the part, as `edged board --marks`: 60x52:8:2")
    ] = "",
    weather_k: Annotated[
        float, typer.Option("--weather", min=0, max=100, help="K: a day's swing, which moves cameras")
    ] = 0.0,
    day_s: Annotated[float, typer.Option("--day", min=1, help="seconds that such a day takes")] = 86400.0,
) -> None:
    """Simulate GigE Vision cameras over UDP, with faults on demand, to test any client of such cameras.

    A virtual cell on 127.0.0.2 and 127.0.0.3:  edged sim

    Pictures from a folder, with 1 % of the packets lost:  edged sim --images DIR --fault packet_loss=0.01

    Reference marks, and a day of +-10 K in ten minutes:  edged sim --marks 60x52:8:2 --weather 10 --day 600

    One camera with a test pattern:  edged sim --pattern 640x480 --left 192.168.7.10 --right none

    While it runs, lines on standard input control faults: `set left unplugged on`, `reboot both`,
    `pulse both Line1`, `steal right`; `help` lists them.
    """
    from edged.commands.sim import SimOptions
    from edged.commands.sim import sim as command

    raise typer.Exit(
        command(
            SimOptions(
                config,
                images,
                pattern,
                (left, right),
                tuple(fault or ()),
                tuple(quirk or ()),
                pulse_hz,
                drift_ppm,
                marks,
                weather_k,
                day_s,
            ),
            screen(),
        )
    )


@app.command()
def registers(
    format: Annotated[
        str | None,
        typer.Option(
            "--format",
            help="md, csv, json; left out: md, or the program of --config's brand; "
            "sources: st, plcopen, scl, twincat, urscript, python; a PLC's own memory: s7db, l5x; "
            "EtherNet/IP: eds; "
            "for robots with lines of text: rapid, karel, krl, krl6, drl, val3, as, spel, melfa, motoplus, "
            "pacscript",
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="folder for formats of several files")
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", help="cell.toml: its address, ports, words, brand and jobs go in"),
    ] = None,
    name: Annotated[
        str,
        typer.Option(help="of several cells of one robot: 2 to 5 letters, in place of edged in all names"),
    ] = "",
    read: Annotated[
        str | None, typer.Option("--read", help="HOST[:PORT] of a cell: print what its registers say")
    ] = None,
    base_address: Annotated[
        int, typer.Option("--base-address", min=0, max=60_000, help="of --read: as in the configuration")
    ] = 0,
    unit_id: Annotated[
        int, typer.Option("--unit-id", min=0, max=255, help="of --read: as in the configuration")
    ] = 1,
) -> None:
    """Print the Modbus map or a client's source, generated from the schema; --read reads a cell."""
    if read is not None:
        from edged.commands.readregisters import read as read_command

        raise typer.Exit(read_command(read, base_address, unit_id, screen()))
    from edged.commands.registers import registers as command

    raise typer.Exit(command(format, output, config, name))


@app.command()
def watch(
    connect: Annotated[
        list[str] | None,
        typer.Option(
            help="Zenoh endpoint of a cell or router, tcp/192.168.1.10:7447 or tls/router:7447; repeat"
        ),
    ] = None,
    cell: Annotated[str | None, typer.Option(help="only this cell; * and ? stand for others")] = None,
    state: Annotated[
        list[str] | None, typer.Option(help="only cells in this state: FAULT, GONE, READY, ...; repeat")
    ] = None,
    certificate: Annotated[Path | None, typer.Option(help="PEM: what a router with mTLS asks for")] = None,
    key: Annotated[Path | None, typer.Option(help="PEM: private key of the certificate")] = None,
    authority: Annotated[Path | None, typer.Option(help="PEM: who signed the router's certificate")] = None,
    shared_key: Annotated[
        Path | None, typer.Option(help="file with the cells' zenoh.shared_key: only what it signs is shown")
    ] = None,
    count: Annotated[int | None, typer.Option(min=1, help="stop after so many results")] = None,
    timeout_s: Annotated[
        float | None, typer.Option("--timeout", min=0.1, help="s: stop then, even without --count results")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="print one JSON object per result, one a line")
    ] = False,
) -> None:
    """Show live results of every cell reachable over Zenoh. 1: --timeout passed before --count results."""
    from edged.app.fleet import ClientTls
    from edged.commands.watch import WatchOptions
    from edged.commands.watch import watch as command

    files = ClientTls(certificate, key, authority)
    options = WatchOptions(
        connect=tuple(connect or WatchOptions().connect),
        cell=cell,
        states=tuple(name.upper() for name in state or ()),
        count=count,
        timeout_s=timeout_s,
        as_json=as_json,
        tls=None if files == ClientTls() else files,
        shared_key=shared_key,
    )
    raise typer.Exit(command(options, screen()))
