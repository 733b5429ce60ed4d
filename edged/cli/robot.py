"""Commands that bring results into a robot's frame, and teach how its tool grips a part."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from edged.cli.options import BrandOption, JsonOption, RigOption, screen

app = typer.Typer()
grasp = typer.Typer(help="How a tool takes a part.", no_args_is_help=True)
app.add_typer(grasp, name="grasp")


@grasp.command("touch")
def grasp_touch(
    rig: RigOption,
    job: Annotated[Path, typer.Option(help="job folder, written by `edged teach`; the grasp is added to it")],
    pose: Annotated[
        str, typer.Option(help="of the tool's tip at the part, as the robot shows it: numbers with commas")
    ],
    brand: BrandOption,
    name: Annotated[str, typer.Option(help="of the grasp")],
    left: Annotated[Path, typer.Argument(help="left image of the part as it lies there")],
    right: Annotated[Path, typer.Argument(help="right image")],
    approach_mm: Annotated[float, typer.Option(min=0, help="from where the tool comes, along its z")] = 50.0,
    retreat_mm: Annotated[
        float | None, typer.Option(min=0, help="how far it goes back; left out: as the approach")
    ] = None,
    symmetry: Annotated[
        int, typer.Option(min=0, help="ways to take the part alike, turned about its z; 0: any")
    ] = 1,
) -> None:
    """Teach a grasp from the robot's pose when it grips the part. 0: added to the job; 1: no good part."""
    from edged.commands.grasp import Touch
    from edged.commands.grasp import touch as command

    retreat = approach_mm if retreat_mm is None else retreat_mm
    asked = Touch(pose, brand, name, approach_mm, retreat, symmetry)
    raise typer.Exit(command(rig, job, left, right, asked, screen()))


@app.command("belt")
def belt_command(
    rig: RigOption,
    board: Annotated[str, typer.Option(help="that lies on the belt, as for calibrate")],
    counts: Annotated[tuple[int, int], typer.Option(help="of the encoder at the first and the second pair")],
    images: Annotated[
        list[Path], typer.Argument(help="left and right image at the first count, then those at the second")
    ],
) -> None:
    """Measure direction and scale of a conveyor belt with a board on it; print its section for cell.toml."""
    from edged.commands.belt import CountedPair
    from edged.commands.belt import belt as command

    if len(images) != 4:
        raise typer.BadParameter(f"expected four images, not {len(images)}")
    first, second = CountedPair(counts[0], *images[:2]), CountedPair(counts[1], *images[2:])
    raise typer.Exit(command(rig, board, first, second, screen()))


register = typer.Typer(help="Bring results into the robot's frame.", no_args_is_help=True)
app.add_typer(register, name="register")
PosesOption = Annotated[
    Path, typer.Option("--poses", help="lines NAME,x,y,z and orientation, as the robot shows them")
]
PairsArgument = Annotated[Path, typer.Argument(help="folder with pairs NAME_left.png, NAME_right.png")]
BoardOption = Annotated[str | None, typer.Option("--board", help="as for calibrate")]


@register.command("touch")
def register_touch(
    rig: RigOption,
    points: Annotated[
        Path, typer.Option(help="lines rig_x,rig_y,rig_z,robot_x,robot_y,robot_z (mm), or LOCATE.json,x,y,z")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="rig file to write")],
    limit: Annotated[float, typer.Option(min=0, help="mm: of each point against all others")] = 0.5,
    as_json: JsonOption = False,
    with_map: Annotated[
        bool, typer.Option("--map", help="also a map of the robot's error, from 12 points or more")
    ] = False,
) -> None:
    """Register from three or more points that the robot touched. 0: saved; 1: over the limit.

    With five or more, a wrong point is identified. Points for a map must surround the places where parts may
    lie.
    """
    from edged.commands.register import touch as command

    raise typer.Exit(command(rig, points, output, limit, as_json, screen(stderr=as_json), with_map=with_map))


@register.command("marks")
def register_marks(
    rig: RigOption,
    former: Annotated[Path, typer.Option(help="the rig as it was calibrated and registered before")],
    former_marks: Annotated[Path, typer.Option(help="marks.json that was taught with that one")],
    output: Annotated[Path, typer.Option("--output", "-o", help="rig file to write")],
    limit: Annotated[float, typer.Option(min=0, help="mm: of each mark against all others")] = 0.05,
) -> None:
    """Carry the registration over to a new calibration by marks taught with both. 0: saved; 1: not.

    Neither plate nor robot may have moved between the two teachings. The new marks.json is beside --rig.
    """
    from edged.commands.register import by_marks as command

    raise typer.Exit(command(rig, former, former_marks, output, limit, screen(soft_wrap=True)))


@register.command("hand-eye")
def register_hand_eye(
    directory: PairsArgument,
    rig: RigOption,
    poses: PosesOption,
    brand: BrandOption,
    output: Annotated[Path, typer.Option("--output", "-o", help="rig file to write")],
    board: BoardOption = None,
    in_hand: Annotated[
        bool, typer.Option("--in-hand", help="the rig is on the flange, the board is not")
    ] = False,
    limit: Annotated[float, typer.Option(min=0, help="mm: rms of held-out poses")] = 0.5,
    as_json: JsonOption = False,
) -> None:
    """Register from flange poses, each with a view of a board on the flange. 0: saved; 1: over the limit."""
    from edged.commands.register import FlangePoses
    from edged.commands.register import hand_eye_command as command

    mount: Literal["eye-in-hand", "eye-to-hand"] = "eye-in-hand" if in_hand else "eye-to-hand"
    console = screen(stderr=as_json)
    raise typer.Exit(
        command(rig, FlangePoses(directory, poses, board), brand, mount, output, limit, as_json, console)
    )


@register.command("self-test")
def register_self_test(
    directory: PairsArgument,
    rig: RigOption,
    poses: PosesOption,
    board: BoardOption = None,
    brand: Annotated[str | None, typer.Option(help="whose poses these should be")] = None,
    as_json: JsonOption = False,
) -> None:
    """Find the convention, unit and mount of the poses by trying all of them. 0: one stands out."""
    from edged.commands.register import FlangePoses
    from edged.commands.register import self_test as command

    raise typer.Exit(
        command(rig, FlangePoses(directory, poses, board), brand, as_json, screen(stderr=as_json))
    )
