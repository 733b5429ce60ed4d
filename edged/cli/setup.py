"""Commands that make a rig and its jobs: pictures, calibration, teaching, registration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from edged.cli.options import JsonOption, RigOption, screen

app = typer.Typer()


@app.command()
def cameras(
    as_json: JsonOption = False,
    report: Annotated[
        Path | None,
        typer.Option(help="look at two cameras for some minutes and write what was seen to this JSON file"),
    ] = None,
    device: Annotated[
        list[str] | None,
        typer.Option(help="of --report: a camera's serial number or IP address; twice, left first"),
    ] = None,
    minutes: Annotated[float, typer.Option(min=0.05, max=60, help="of --report: how long")] = 5.0,
    give_address: Annotated[
        str | None,
        typer.Option(metavar="SERIAL", help="give this GigE camera an address in this machine's network"),
    ] = None,
    address: Annotated[str, typer.Option(help="of --give-address: this one; left out: a free one")] = "",
) -> None:
    """List the GenICam cameras that answer, their addresses, and whether they can be used.

    --give-address reaches a camera whose address is in another network (GigE Vision's FORCEIP), and makes it
    keep the new one. A camera controlled by another program is left alone.

    With --report, two of them are tested: firmware, features, missing features, skew of both exposures, time
    from trigger to images, packets resent at full rate, temperature. They are set up as in a cell.
    """
    from edged.commands.cameras import address as give
    from edged.commands.cameras import cameras as command
    from edged.commands.cameras import report as look

    if give_address is not None:
        raise typer.Exit(give(give_address, address, screen()))
    if report is not None:
        raise typer.Exit(look(report, device or [], minutes, screen(stderr=True)))
    raise typer.Exit(command(as_json, screen()))


@app.command()
def grab(
    config: Annotated[Path, typer.Argument(help="configuration file: its cameras are used")],
    output: Annotated[Path, typer.Option("--output", "-o", help="folder for the pictures")],
    count: Annotated[int, typer.Option(min=1, max=1000, help="pairs")] = 1,
    name: Annotated[str, typer.Option(help="beginning of the file names")] = "pair",
) -> None:
    """Save pairs of pictures, for calibration and teaching.

    With --count, a terminal asks for Enter before each pair; otherwise a pair is taken whenever the view has
    changed and is at rest. Each pair is on disc before the next is taken, and none is ever overwritten.
    """
    from edged.commands.grab import grab as command

    raise typer.Exit(command(config, output, count, name, screen(stderr=True)))


@app.command()
def board(
    output: Annotated[Path, typer.Option("--output", "-o", help="PDF file to write")],
    spec: Annotated[
        str | None, typer.Argument(help="for example chessboard:11x8:15 (inner corners, square in mm)")
    ] = None,
    marks: Annotated[
        str | None,
        typer.Option(
            help="reference marks instead: WIDTHxHEIGHT:COUNT:DIAMETER_MM[:FIRST_CODE], as 120x90:8:4:0"
        ),
    ] = None,
    paper: Annotated[
        str | None, typer.Option(help="A5 to A1 or letter; the smallest of A5 to A1 that fits if not given")
    ] = None,
) -> None:
    """Draw a calibration board or reference marks to print, with rulers to check the print's scale."""
    from edged.commands.board import board as command

    raise typer.Exit(command(spec, paper, output, screen(stderr=True), marks=marks))


@app.command()
def calibrate(
    directory: Annotated[Path, typer.Argument(help="folder with pairs NAME_left.png, NAME_right.png")],
    output: Annotated[Path, typer.Option("--output", "-o", help="rig file to write")],
    board: Annotated[
        str | None,
        typer.Option(
            help="for example chessboard:11x8:4.0 (inner corners, square in mm), or 4.0 alone: the rest is "
            "seen in the pictures"
        ),
    ] = None,
    model: Annotated[str, typer.Option(help="lens model: division, brown, or auto: by the views")] = "auto",
    report: Annotated[Path | None, typer.Option(help="HTML report to write")] = None,
    plate_shape: Annotated[
        bool, typer.Option("--plate-shape", help="measure how the board is bent and misprinted, too")
    ] = False,
) -> None:
    """Calibrate a stereo rig from pairs of pictures of a board."""
    from edged.commands.calibrate import calibrate as command

    console = screen(stderr=True)
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
    """Check a rig with one fresh pair: rows must agree, and a known length must come out right."""
    from edged.commands.verify import verify as command
    from edged.setup.calibration.checking import Limits

    limits = Limits(max_epipolar, max_length_error)
    raise typer.Exit(command(rig, (left, right), board, job, length or [], limits, as_json, screen()))


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
    from edged.commands.rig import convert as command

    raise typer.Exit(command(source, target, to, from_, size, unit, pixel_um, screen(stderr=True)))


@app.command()
def teach(
    rig: RigOption,
    name: Annotated[str, typer.Option(help="name of the job")],
    output: Annotated[Path, typer.Option("--output", "-o", help="job folder to write")],
    left: Annotated[
        list[Path] | None,
        typer.Option(
            help="left image; again for further pairs, which show the part tilted, or in other light"
        ),
    ] = None,
    right: Annotated[
        list[Path] | None, typer.Option(help="right image, of each pair in the same order")
    ] = None,
    region: Annotated[
        str | None,
        typer.Option(
            "--region",
            "--roi",
            help="around the part, pixels of the left image, default: the whole picture. X,Y,W,H, "
            "circle:X,Y,R, polygon:X,Y;X,Y;..., or mask:FILE.png, white where the part is",
        ),
    ] = None,
    exclude: Annotated[
        list[str] | None, typer.Option(help="what of the picture is not the part, in the same forms; repeat")
    ] = None,
    step: Annotated[
        Path | None,
        typer.Option(
            help="STEP (extra `cad`) or STL file of the part: its sizes and its frame; with a pair, or with "
            "--depth"
        ),
    ] = None,
    up: Annotated[
        str | None, typer.Option(help="axis of the STEP file that points to the cameras: z, -z, x, ...")
    ] = None,
    dxf: Annotated[Path | None, typer.Option(help="drawing to teach from, instead of a pair")] = None,
    contour: Annotated[
        Path | None, typer.Option(help="outlines to teach from: x,y in mm a line, empty lines between them")
    ] = None,
    depth: Annotated[
        float | None,
        typer.Option(help="of a drawing or STEP file: nominal distance of the face from the left camera, mm"),
    ] = None,
    layer: Annotated[list[str] | None, typer.Option(help="of a DXF drawing: only this layer; repeat")] = None,
    unit: Annotated[
        str | None, typer.Option(help="of an STL file, or a DXF drawing that does not say: mm, cm, m, in")
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
    tilt: Annotated[
        float | None,
        typer.Option(
            help="how far the part may lie tilted to any side, degrees up to 45, from the bisector of the "
            "cameras; default: about as at teaching"
        ),
    ] = None,
    number: Annotated[
        int | None,
        typer.Option(
            min=1, max=65535, help="of the job on the PLC; default: as before, or the next free one"
        ),
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="HTML page to write: the model, and what it promises")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Teach a job from one stereo pair, or from a drawing: shape model and metric features."""
    from edged.commands.teach import DrawingSource, PairSource, TeachOptions, chosen_source, parse_contrast
    from edged.commands.teach import teach as command
    from edged.vision.edges.hysteresis import EdgeThresholds
    from edged.vision.shape.params import ModelParams

    source = chosen_source(
        PairSource.of(left or (), right or (), region=region, exclude=tuple(exclude or ()), step=step, up=up),
        DrawingSource(dxf, contour, depth, tuple(layer or ()), unit),
    )
    params = ModelParams(EdgeThresholds(*parse_contrast(contrast), min_component), levels)
    asked = TeachOptions(number, params, tilt)
    console = screen(stderr=True)
    raise typer.Exit(command(rig, source, name, output, console, asked, report=report, as_json=as_json))


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
    convention: Annotated[
        str, typer.Option(help="what A, B, C are, as modbus.convention: kuka_abc, abb_zyx, ...")
    ] = "fixed_xyz",
) -> None:
    """Locate the part in one stereo pair, offline."""
    from edged.commands.locate import LocateOutputs
    from edged.commands.locate import locate as command

    raise typer.Exit(
        command(rig, job, left, right, as_json, screen(), LocateOutputs(overlay, ply, cloud), convention)
    )


@app.command()
def golden(
    rig: RigOption,
    job: Annotated[Path, typer.Option(help="job folder, written by `edged teach`")],
    left: Annotated[Path, typer.Argument(help="left image of the part as it lay when the path was taught")],
    right: Annotated[Path, typer.Argument(help="right image")],
) -> None:
    """Save the pose of the part for which a path was taught; results then carry their offset from it.

    Written beside the rig, as the command GOLDEN does; a running cell uses it after a reload. 0: saved, 1:
    not exactly one good part.
    """
    from edged.commands.golden import golden as command

    raise typer.Exit(command(rig, job, left, right, screen()))


@app.command()
def accept(
    directory: Annotated[
        Path, typer.Argument(help="folder with still/, pose/ (and truth.csv), length/, robot/touched.csv")
    ],
    rig: RigOption,
    job: Annotated[Path, typer.Option(help="job of the part in still/ and pose/")],
    output: Annotated[Path, typer.Option("--output", "-o", help="folder for the page and its figures")],
    length: Annotated[
        str | None,
        typer.Option(help="NAME=MM: what is measured in length/, as in `edged verify`, e.g. c0-c1=60"),
    ] = None,
    length_job: Annotated[
        Path | None, typer.Option(help="job of the bar in length/; left out: --job")
    ] = None,
    truth_um: Annotated[float, typer.Option(min=0, max=1000, help="one sigma of pose/truth.csv")] = 2.0,
    robot_um: Annotated[
        float, typer.Option(min=0.1, max=10_000, help="one sigma of a touch: the robot's accuracy as stated")
    ] = 50.0,
    days: Annotated[int, typer.Option(min=1, max=3650, help="until the test is due again")] = 365,
    by: Annotated[str, typer.Option(help="who made the test")] = "",
    sign: Annotated[
        Path | None, typer.Option("--sign", help="private key (Ed25519, PEM): sign acceptance.json")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Run a cell's acceptance test on site and write a page to sign. 0: passed; 1: not, or incomplete."""
    from edged.commands.accept import Signed
    from edged.commands.accept import accept as command
    from edged.commands.verify import parse_length
    from edged.setup.acceptance.accepting import StatedTruth

    known = None if length is None else parse_length(length)
    shown = StatedTruth(known, length_job, truth_um, robot_um, days)
    console = screen(soft_wrap=True)
    raise typer.Exit(
        command(directory, rig, job, output, shown, console, signed=Signed(by, sign), as_json=as_json)
    )


@app.command()
def study(
    directory: Annotated[Path, typer.Argument(help="folder with master/, or parts/PART/PERSON/, or both")],
    rig: RigOption,
    job: Annotated[Path, typer.Option(help="job of the parts")],
    size: Annotated[str, typer.Option(help="what is inspected: a circle's name, two as A-B, a measurement")],
    tolerance: Annotated[str, typer.Option(help="LOW:HIGH, mm")],
    reference: Annotated[float | None, typer.Option(help="mm: true size of the master")] = None,
    report: Annotated[Path | None, typer.Option(help="HTML page to write")] = None,
    as_json: JsonOption = False,
) -> None:
    """Test fitness to inspect a size: capability by a master, gauge R&R by parts. 0: fit; 1: not."""
    from edged.commands.study import parse_tolerance
    from edged.commands.study import study as command
    from edged.setup.acceptance.studying import StudiedSize

    of, console = StudiedSize(size, *parse_tolerance(tolerance)), screen(soft_wrap=True)
    raise typer.Exit(
        command(directory, rig, job, of, console, reference=reference, report=report, as_json=as_json)
    )


Material = Literal["steel", "aluminium", "invar", "ceramic", "glass"]
MaterialOption = Annotated[Material, typer.Option(help="what the marks are on, as marks.material")]

marks = typer.Typer(help="Reference marks, which keep a cell true.", no_args_is_help=True)
app.add_typer(marks, name="marks")


@marks.command("teach")
def marks_teach(
    directory: Annotated[Path, typer.Argument(help="folder with 50 pairs NAME_left.png, NAME_right.png")],
    rig: RigOption,
    material: MaterialOption = "steel",
) -> None:
    """Teach the marks while the calibration is fresh, from 50 pairs of a still cell (`edged grab`).

    Written as marks.json beside the rig; a running cell uses them after a reload. 0: saved.
    """
    from edged.commands.marks import teach as command

    raise typer.Exit(command(directory, rig, material, screen()))


@marks.command("status")
def marks_status(
    rig: RigOption,
    left: Annotated[Path, typer.Argument(help="left image")],
    right: Annotated[Path, typer.Argument(help="right image")],
    material: MaterialOption = "steel",
    range_k: Annotated[float, typer.Option(min=0.001, max=100, help="as marks.range_k")] = 10.0,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object")] = False,
) -> None:
    """Show the marks of one pair: motion of each dot since teaching, and displacement of the cameras.

    0: results may be given; 1: not, with the reason.
    """
    from edged.commands.marks import status as command
    from edged.vision.marks.tracking import MarksSettings

    settings = MarksSettings(material, range_k)
    raise typer.Exit(command(rig, left, right, settings, screen(), as_json=as_json))
