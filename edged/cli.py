"""The command line: parses, calls `commands`, and turns errors into exit codes.

0: done. 1: ran, and the answer is "no" (no target, check failed). 2: wrong usage or input; the
message goes to stderr and names the file, the field and what was expected.

Each command imports what it needs when it runs, so that `edged --help` stays quick.
"""

from __future__ import annotations

import gc
from pathlib import Path
from typing import Annotated, Literal

import typer

from edged import __version__

app = typer.Typer(
    name="edged",
    help="Where is the workpiece? Two GenICam cameras in, coordinates with a sigma out.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)

RigOption = Annotated[Path, typer.Option("--rig", help="calibrated rig, written by `edged calibrate`")]
JsonOption = Annotated[bool, typer.Option("--json", help="print one JSON object and nothing else on stdout")]


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"edged {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="show the version")
    ] = False,
) -> None:
    pass


@app.command()
def run(
    config: Annotated[Path, typer.Argument(help="configuration file, see config/cell.toml")],
) -> None:
    """Run the daemon until SIGTERM; SIGHUP reloads the configuration."""
    gc.disable()  # imports leave no garbage, and looking for it is a tenth of the start; `serve` enables it
    from edged.commands.run import run as command

    raise typer.Exit(command(config))


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
) -> None:
    """Run a virtual cell and the daemon on this machine; shows measured against true position."""
    from edged.commands.demo import DemoOptions
    from edged.commands.demo import demo as command

    raise typer.Exit(
        command(
            DemoOptions(
                cycles, period_s, in_process, modbus_port, zenoh_port, web_port or None, folder, as_json
            )
        )
    )


@app.command()
def check(
    config: Annotated[Path, typer.Argument(help="configuration file")],
    as_json: JsonOption = False,
) -> None:
    """Validate configuration, rig and jobs; report every mistake in one go."""
    from edged.commands.check import check as command

    raise typer.Exit(command(config, as_json=as_json))


@app.command()
def calibrate(
    directory: Annotated[Path, typer.Argument(help="folder with pairs NAME_left.png, NAME_right.png")],
    board: Annotated[str, typer.Option(help="for example chessboard:11x8:4.0 (inner corners, square in mm)")],
    output: Annotated[Path, typer.Option("--output", "-o", help="rig file to write")],
    model: Annotated[str, typer.Option(help="lens model: brown or division")] = "brown",
    report: Annotated[Path | None, typer.Option(help="HTML report to write")] = None,
    plate_shape: Annotated[
        bool, typer.Option("--plate-shape", help="measure how the board is bent and misprinted, too")
    ] = False,
) -> None:
    """Calibrate a stereo rig from pairs of pictures of a board."""
    from rich.console import Console

    from edged.commands.calibrate import calibrate as command

    console = Console(stderr=True)
    raise typer.Exit(command(directory, board, output, model, report, console, plate_shape=plate_shape))


@app.command()
def verify(
    rig: RigOption,
    left: Annotated[Path, typer.Argument(help="left image")],
    right: Annotated[Path, typer.Argument(help="right image")],
    board: Annotated[
        str | None, typer.Option(help="the board in the images, as for `edged calibrate`")
    ] = None,
    job: Annotated[Path | None, typer.Option(help="job folder of the part in the images")] = None,
    length: Annotated[
        list[str] | None,
        typer.Option(
            help="NAME=MM, a known size of the part: c0 (diameter), c0-c1 (distance), or a measurement"
        ),
    ] = None,
    max_epipolar: Annotated[float, typer.Option(min=0, help="largest epipolar rms, px")] = 0.3,
    max_length_error: Annotated[float, typer.Option(min=0, help="largest length error, percent")] = 0.1,
    as_json: JsonOption = False,
) -> None:
    """Check a rig against one fresh pair: rows must agree, and a known length must come out."""
    from rich.console import Console

    from edged.commands.verify import Limits
    from edged.commands.verify import verify as command

    limits = Limits(max_epipolar, max_length_error)
    raise typer.Exit(command(rig, left, right, board, job, length or [], limits, as_json, Console()))


rig_app = typer.Typer(name="rig", help="Rig files of other software.", no_args_is_help=True)
app.add_typer(rig_app)


@rig_app.callback()
def _rig() -> None:
    pass


@rig_app.command("convert")
def rig_convert(
    source: Annotated[Path, typer.Argument(help="rig file, or folder of ROS or HALCON files")],
    target: Annotated[Path, typer.Argument(help="file or folder to write")],
    to: Annotated[str, typer.Option(help="edged, opencv, ros, kalibr or halcon")] = "edged",
    from_: Annotated[str | None, typer.Option("--from", help="the same; default: by content")] = None,
    size: Annotated[str | None, typer.Option(help="WIDTHxHEIGHT, for OpenCV files without it")] = None,
    unit: Annotated[str, typer.Option(help="mm, cm or m: the unit of an OpenCV file to be read")] = "mm",
    pixel_um: Annotated[
        float, typer.Option("--pixel-um", help="pixel size for HALCON files; any gives the same geometry")
    ] = 3.45,
) -> None:
    """Convert a rig from or to OpenCV, ROS camera_info, Kalibr or HALCON."""
    from rich.console import Console

    from edged.commands.rig import convert as command

    raise typer.Exit(command(source, target, to, from_, size, unit, pixel_um, Console(stderr=True)))


@app.command()
def teach(
    rig: RigOption,
    name: Annotated[str, typer.Option(help="name of the job")],
    output: Annotated[Path, typer.Option("--output", "-o", help="job folder to write")],
    left: Annotated[Path | None, typer.Option(help="left image")] = None,
    right: Annotated[Path | None, typer.Option(help="right image")] = None,
    region: Annotated[
        str | None,
        typer.Option(
            "--region",
            "--roi",
            help="around the part, pixels of the left image: X,Y,W,H, circle:X,Y,R, "
            "polygon:X,Y;X,Y;..., or mask:FILE.png, white where the part is",
        ),
    ] = None,
    exclude: Annotated[
        list[str] | None, typer.Option(help="what of the region is not the part, in the same forms; repeat")
    ] = None,
    dxf: Annotated[Path | None, typer.Option(help="drawing to teach from, instead of a pair")] = None,
    contour: Annotated[
        Path | None, typer.Option(help="outlines to teach from: x,y in mm a line, empty lines between them")
    ] = None,
    depth: Annotated[
        float | None, typer.Option(help="of a drawing: nominal distance of the face from the left camera, mm")
    ] = None,
    layer: Annotated[list[str] | None, typer.Option(help="of a DXF drawing: only this layer; repeat")] = None,
    unit: Annotated[
        str | None, typer.Option(help="of a DXF drawing that does not say: mm, cm, m, in")
    ] = None,
    contrast: Annotated[
        str | None, typer.Option(help="LOW,HIGH: edges that count, grey values per px; default: automatic")
    ] = None,
    min_component: Annotated[
        float | None, typer.Option(help="shortest connected edge that counts, px; default: automatic")
    ] = None,
    levels: Annotated[
        int | None, typer.Option(help="most levels of the pyramid, 1 to 5; default: automatic")
    ] = None,
    number: Annotated[int, typer.Option(min=1, max=65535, help="number of the job on the PLC")] = 1,
    report: Annotated[
        Path | None, typer.Option(help="HTML page to write: the model, and what it promises")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Teach a job from one stereo pair, or from a drawing: shape model and metric features."""
    from rich.console import Console

    from edged.commands.teach import DrawingSource, PairSource, chosen_source, parse_contrast
    from edged.commands.teach import teach as command
    from edged.vision.shape.modelparams import ModelParams

    source = chosen_source(
        PairSource(left, right, region, tuple(exclude or ())),
        DrawingSource(dxf, contour, depth, layer or [], unit),
    )
    params = ModelParams(*parse_contrast(contrast), min_component, levels)
    console = Console(stderr=True)
    raise typer.Exit(
        command(
            rig, source, name, output, console, number=number, params=params, report=report, as_json=as_json
        )
    )


@app.command()
def locate(
    rig: RigOption,
    job: Annotated[Path, typer.Option(help="job folder, written by `edged teach`")],
    left: Annotated[Path, typer.Argument(help="left image")],
    right: Annotated[Path, typer.Argument(help="right image")],
    as_json: JsonOption = False,
    overlay: Annotated[
        Path | None, typer.Option(help="picture to write: the pair with what was measured")
    ] = None,
    ply: Annotated[
        Path | None, typer.Option(help="point cloud to write: contours and matched face points")
    ] = None,
    cloud: Annotated[Path | None, typer.Option(help="picture to write: the point cloud")] = None,
) -> None:
    """Locate the part in one stereo pair, offline."""
    from rich.console import Console

    from edged.commands.locate import locate as command

    raise typer.Exit(
        command(rig, job, left, right, as_json, Console(), overlay=overlay, ply=ply, cloud=cloud)
    )


@app.command()
def cameras(as_json: JsonOption = False) -> None:
    """List the GenICam cameras that answer, and whether they can be used."""
    from rich.console import Console

    from edged.commands.cameras import cameras as command

    raise typer.Exit(command(as_json, Console()))


@app.command()
def grab(
    config: Annotated[Path, typer.Argument(help="configuration file: its cameras are used")],
    output: Annotated[Path, typer.Option("--output", "-o", help="folder for the pictures")],
    count: Annotated[int, typer.Option(min=1, max=1000, help="pairs")] = 1,
    name: Annotated[str, typer.Option(help="beginning of the file names")] = "pair",
) -> None:
    """Save pairs of pictures, for calibration and teaching."""
    from rich.console import Console

    from edged.commands.cameras import grab as command

    raise typer.Exit(command(config, output, count, name, Console(stderr=True)))


@app.command()
def doctor(
    config: Annotated[Path, typer.Argument(help="configuration file")],
    trigger: Annotated[bool, typer.Option(help="take test pictures")] = True,
    as_json: JsonOption = False,
) -> None:
    """Examine machine, network and cameras: what will bite, and the command that fixes it."""
    from rich.console import Console

    from edged.commands.doctor import doctor as command

    raise typer.Exit(command(config, as_json, Console(), trigger=trigger))


register = typer.Typer(help="Bring results into the robot's frame.", no_args_is_help=True)
app.add_typer(register, name="register")
PosesOption = Annotated[
    Path, typer.Option("--poses", help="lines NAME,x,y,z and orientation, as the robot shows them")
]
PairsArgument = Annotated[Path, typer.Argument(help="folder with pairs NAME_left.png, NAME_right.png")]
BoardOption = Annotated[str, typer.Option("--board", help="as for calibrate")]


@register.command("touch")
def register_touch(
    rig: RigOption,
    points: Annotated[
        Path, typer.Option(help="lines rig_x,rig_y,rig_z,robot_x,robot_y,robot_z (mm), or LOCATE.json,x,y,z")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="rig file to write")],
    limit: Annotated[float, typer.Option(min=0, help="mm: of each point against all others")] = 0.5,
    as_json: JsonOption = False,
) -> None:
    """From three or more points that the robot touched. 0: saved; 1: over the limit."""
    from rich.console import Console

    from edged.commands.register import touch as command

    raise typer.Exit(command(rig, points, output, limit, as_json, Console(stderr=as_json)))


@register.command("hand-eye")
def register_hand_eye(
    directory: PairsArgument,
    rig: RigOption,
    poses: PosesOption,
    board: BoardOption,
    brand: Annotated[str, typer.Option(help="ur, kuka, fanuc, yaskawa, abb, staubli or kawasaki")],
    output: Annotated[Path, typer.Option("--output", "-o", help="rig file to write")],
    in_hand: Annotated[
        bool, typer.Option("--in-hand", help="the rig is on the flange, the board is not")
    ] = False,
    limit: Annotated[float, typer.Option(min=0, help="mm: rms of held-out poses")] = 0.5,
    as_json: JsonOption = False,
) -> None:
    """From poses of the flange, each with a view of a board that it holds. 0: saved; 1: over the limit."""
    from rich.console import Console

    from edged.commands.register import hand_eye_command as command

    mount: Literal["eye-in-hand", "eye-to-hand"] = "eye-in-hand" if in_hand else "eye-to-hand"
    console = Console(stderr=as_json)
    raise typer.Exit(command(rig, directory, poses, board, brand, mount, output, limit, as_json, console))


@register.command("self-test")
def register_self_test(
    directory: PairsArgument,
    rig: RigOption,
    poses: PosesOption,
    board: BoardOption,
    brand: Annotated[str | None, typer.Option(help="whose poses these should be")] = None,
    as_json: JsonOption = False,
) -> None:
    """Which convention, unit and mount the poses are in: every reading is tried. 0: one stands out."""
    from rich.console import Console

    from edged.commands.register import self_test as command

    raise typer.Exit(command(rig, directory, poses, board, brand, as_json, Console(stderr=as_json)))


@app.command()
def replay(
    path: Annotated[Path, typer.Argument(help="a recording, or a recorder's folder")],
    as_json: JsonOption = False,
    export: Annotated[
        Path | None, typer.Option(help="folder to write the recordings, their setups and a report to")
    ] = None,
) -> None:
    """Measure recorded cycles again; says if any result differs in a single bit."""
    from rich.console import Console

    from edged.commands.replay import replay as command

    raise typer.Exit(command(path, as_json, Console(), export))


@app.command()
def backup(
    config: Annotated[Path, typer.Argument(help="configuration file")],
    output: Annotated[Path, typer.Option("--output", "-o", help="archive to write, FILE.tar.gz")],
    force: Annotated[bool, typer.Option("--force", help="replace an archive of that name")] = False,
) -> None:
    """Put configuration, rig, jobs and the register map into one checksummed archive."""
    from rich.console import Console

    from edged.commands.backup import backup as command

    raise typer.Exit(command(config, output, Console(soft_wrap=True), force=force))


@app.command()
def restore(
    archive: Annotated[Path, typer.Argument(help="written by `edged backup`")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="folder to make; without it the archive is checked")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="replace a folder that is in use; it is kept beside")
    ] = False,
) -> None:
    """Check a backup and make a folder of it. 0: done; 1: done, but it would not start."""
    from rich.console import Console

    from edged.commands.backup import restore as command

    raise typer.Exit(command(archive, output, Console(soft_wrap=True), force=force))


@app.command()
def password() -> None:
    """Ask for a password and print its hash, for `web.password_hash`."""
    from edged.commands.password import password as command

    raise typer.Exit(command())


@app.command()
def status(
    url: Annotated[str, typer.Option(help="status page of the cell")] = "http://127.0.0.1:8080",
    as_json: JsonOption = False,
) -> None:
    """Show what the cell does now, from its status page. 0: ready; 1: not ready or not reached."""
    from rich.console import Console

    from edged.commands.status import status as command

    raise typer.Exit(command(url, as_json, Console()))


@app.command()
def registers(
    format: Annotated[
        str, typer.Option("--format", help="md, csv, json; sources: st, urscript, python")
    ] = "md",
) -> None:
    """Print the Modbus map or a client's source, generated from the schema that encodes it."""
    from edged.commands.registers import registers as command

    raise typer.Exit(command(format))


@app.command()
def watch(
    connect: Annotated[
        list[str] | None,
        typer.Option(help="Zenoh endpoint, for example tcp/192.168.1.10:7447; may be repeated"),
    ] = None,
    cell: Annotated[str | None, typer.Option(help="only this cell")] = None,
    count: Annotated[int | None, typer.Option(min=1, help="stop after so many results")] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="print one JSON object per result, one a line")
    ] = False,
) -> None:
    """Show live results of every cell that is reachable over Zenoh."""
    from rich.console import Console

    from edged.commands.watch import watch as command

    raise typer.Exit(command(connect or ["tcp/127.0.0.1:7447"], cell, as_json, count, Console()))


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
) -> None:
    """Simulate GigE Vision cameras over UDP, with faults at will, to test any client of such cameras.

    A virtual cell on 127.0.0.2 and 127.0.0.3:  edged sim

    Pictures of a folder, 1 % of the packets lost:  edged sim --images DIR --fault packet_loss=0.01

    One camera with a test pattern:  edged sim --pattern 640x480 --left 192.168.7.10 --right none

    While it runs, lines on standard input change what goes wrong: `set left unplugged on`, `reboot both`,
    `pulse both Line1`, `steal right`; `help` lists them.
    """
    from rich.console import Console

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
            ),
            Console(),
        )
    )


@app.command()
def warm(
    if_needed: Annotated[
        bool, typer.Option("--if-needed", help="do nothing when the kernels are cached")
    ] = False,
) -> None:
    """Compile the numerical kernels once, so that the daemon starts quickly."""
    from edged.commands.warm import warm as command

    raise typer.Exit(command(only_if_needed=if_needed))
