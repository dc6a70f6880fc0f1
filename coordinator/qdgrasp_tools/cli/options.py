"""Options that several commands share."""

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from qdgrasp_protocol.build_messages import MeshPreparation
from qdgrasp_protocol.cli_support import PROCESSES
from qdgrasp_protocol.engines import DEVICE_ENGINE
from qdgrasp_protocol.errors import ImpossibleValue, InputError
from qdgrasp_protocol.spec import ANY_RESTING_POSE, MOST_RESTING_POSES

MESH_FILE, SEARCH, EVALUATION = "Mesh file of an object", "Search", "Evaluation of a pose"
END, CHOICE = "End, besides the budget", "Choice of grasps"
"""Headings of options in the help of commands."""

Gripper = Annotated[str | None, typer.Option(help="Gripper: a built-in name or a TOML file.")]
Object = Annotated[str | None, typer.Option("--object", help="Object: a built-in name or a mesh file.")]
Mass = Annotated[
    float | None,
    typer.Option(help="Mass of the object [kg]; needed for a mesh file.", rich_help_panel=MESH_FILE),
]
Scale = Annotated[
    float | None,
    typer.Option(
        metavar="S", help="Metres to a unit of the mesh file; default 1.", rich_help_panel=MESH_FILE
    ),
]
Units = Annotated[
    str | None,
    typer.Option(
        metavar="mm|cm|m|in", help="The unit of the mesh file, for --scale.", rich_help_panel=MESH_FILE
    ),
]
Friction = Annotated[
    float | None, typer.Option(help="Lateral friction of the object; default 0.5.", rich_help_panel=MESH_FILE)
]
Simplify = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        min=20,
        max=500_000,
        help="Simplify the mesh to at most N triangles.",
        rich_help_panel=MESH_FILE,
    ),
]
Remesh = Annotated[
    bool,
    typer.Option(
        "--remesh",
        help="Make a new closed surface around what the mesh file holds.",
        rich_help_panel=MESH_FILE,
    ),
]
Hull = Annotated[
    bool,
    typer.Option("--hull", help="Take the convex hull of the mesh in its place.", rich_help_panel=MESH_FILE),
]
Glued = Annotated[
    bool,
    typer.Option(
        "--glued", help="Bodies that are apart are meant to be one rigid object.", rich_help_panel=MESH_FILE
    ),
]
SkipUnusable = Annotated[
    bool, typer.Option("--skip-unusable", help="Go on without objects that cannot be used, and report them.")
]
ProtocolOption = Annotated[
    str | None,
    typer.Option(
        "--protocol",
        help="Evaluation protocol: paper, physical, lift, released, robust; default physical of `run` and of "
        "a campaign of meshes, else paper.",
        rich_help_panel=EVALUATION,
    ),
]
BaseOption = Annotated[
    str | None,
    typer.Option(
        "--base",
        help="Protocol of each trial of robust: paper or physical; default paper.",
        rich_help_panel=EVALUATION,
    ),
]
EngineOption = Annotated[
    str | None,
    typer.Option(
        "--engine",
        help="Physics engine: bullet, mujoco, or both: bullet,mujoco tries in mujoco what holds in bullet; "
        "released has bullet alone, physical also mujoco-warp; default bullet.",
        rich_help_panel=EVALUATION,
    ),
]
ApproachDistance = Annotated[
    float | None,
    typer.Option(
        "--approach-distance",
        metavar="M",
        min=0,
        max=1,
        help="Distance [m] from which the open hand comes along its approach axis, touching nothing; default "
        "0, with --resting-pose 0.1.",
        rich_help_panel=EVALUATION,
    ),
]
RestingPoseOption = Annotated[
    str | None,
    typer.Option(
        "--resting-pose",
        metavar="N|any",
        help="The object rests on a table, in pose N of `qdgrasp asset resting-poses`, and the hand comes "
        "above it; any: in one of its poses at least.",
        rich_help_panel=EVALUATION,
    ),
]
Trials = Annotated[
    str | None,
    typer.Option(
        help="Trials of a success under robust: all (100), or sequential: 10, and more where it competes for "
        "its cell; default all, sequential with --aim-for eta --protocol robust and no SPEC.",
        rich_help_panel=EVALUATION,
    ),
]
Finalists = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        help="With sequential trials: the N best of all instead of those of cells.",
        rich_help_panel=EVALUATION,
    ),
]
AimFor = Annotated[
    str | None,
    typer.Option(
        help="Aim of the search aimed: hold, touch, eta (needs --protocol robust), margin; default hold.",
        rich_help_panel=SEARCH,
    ),
]
Diversity = Annotated[
    str | None,
    typer.Option(
        help="Values that tell grasps apart: position, orientation, posture; default position.",
        rich_help_panel=SEARCH,
    ),
]
GraspsPerCell = Annotated[
    int | None,
    typer.Option(
        metavar="N", min=1, max=60, help="Different grasps that fill a cell of 1 cm.", rich_help_panel=SEARCH
    ),
]
Seed = Annotated[int | None, typer.Option(help="Seed of the search; default 0.", rich_help_panel=SEARCH)]
WarmStarts = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="RUN",
        help="Begin with what this run of the same hand learned; repeatable.",
        rich_help_panel=SEARCH,
    ),
]
OverlapsMode = Annotated[
    str | None,
    typer.Option(
        help="count: every pose is an evaluation; redraw: simulated ones are; default: the method's.",
        rich_help_panel=SEARCH,
    ),
]
Population = Annotated[
    int | None,
    typer.Option(
        help="Genomes in a generation; default: the method's, see `qdgrasp methods`.", rich_help_panel=SEARCH
    ),
]
MutationSigma = Annotated[
    float | None,
    typer.Option(help="Standard deviation of the Gaussian mutation; default 0.1.", rich_help_panel=SEARCH),
]
MutationProbability = Annotated[
    float | None,
    typer.Option(help="Probability that a gene is mutated; default 0.3.", rich_help_panel=SEARCH),
]
GenerationsInFlight = Annotated[
    int | None,
    typer.Option(
        help="Generations asked before the first is told; default: the method's.", rich_help_panel=SEARCH
    ),
]
InFlight = Annotated[
    int | None,
    typer.Option(
        help="Most genomes in flight, which become more as the run goes on; default: the method's.",
        rich_help_panel=SEARCH,
    ),
]
SurfaceSeed = Annotated[
    int | None, typer.Option(help="Seed of the surface points; default 0.", rich_help_panel=MESH_FILE)
]
Workers = Annotated[int | None, typer.Option(min=0, help="Worker processes; default: one per core.")]
OwnWorkers = Annotated[
    int | None, typer.Option("--workers", min=1, help="Worker processes; default: one per core.")
]
Successes = Annotated[
    int | None,
    typer.Option(min=1, help="End with so many successes; default: with the budget.", rich_help_panel=END),
]
Grasps = Annotated[
    int | None,
    typer.Option(
        metavar="N", min=1, help="End with so many grasps; default: with the budget.", rich_help_panel=END
    ),
]
Saturation = Annotated[
    float | None,
    typer.Option(
        metavar="SHARE",
        min=0,
        help="End when 1000 simulated evaluations found new niches with a grasp at this share of the mean "
        "rate, below 1; 0: never.",
        rich_help_panel=END,
    ),
]
NoNewCell = Annotated[
    int | None,
    typer.Option(
        metavar="N", min=1, help="End when N evaluations in a row found no new cell.", rich_help_panel=END
    ),
]
Seconds = Annotated[
    float | None,
    typer.Option(
        min=0,
        help="Stop after so many seconds; what is recorded stays, and can be gone on with.",
        rich_help_panel=END,
    ),
]
BatchSize = Annotated[
    int | None,
    typer.Option(
        "--batch-size", min=1, max=4096, help="Rows in a batch; default: measured.", rich_help_panel=PROCESSES
    ),
]
Checked = Annotated[
    float,
    typer.Option(
        "--checked",
        metavar="SHARE",
        min=0,
        max=1,
        help="Share of the rows that a second worker evaluates too.",
        rich_help_panel=PROCESSES,
    ),
]
Listen = Annotated[
    str | None,
    typer.Option(
        help="Endpoint of the embedded router; default: port 7447 on loopback, or a free one.",
        rich_help_panel=PROCESSES,
    ),
]
DiskWait = Annotated[
    float, typer.Option(min=0, help="Seconds to wait for room on a full disk.", rich_help_panel=PROCESSES)
]
Job = Annotated[
    str | None, typer.Option(help="Name on the bus; default: the folder's name.", rich_help_panel=PROCESSES)
]
MaxPenetration = Annotated[
    float | None,
    typer.Option(
        min=0, metavar="MM", help="Deepest penetration after closing [mm], at most.", rich_help_panel=CHOICE
    ),
]
MaxMotion = Annotated[
    float | None,
    typer.Option(
        min=0,
        metavar="MM",
        help="Way of the object in the hand while it closed [mm], at most.",
        rich_help_panel=CHOICE,
    ),
]
MinMargin = Annotated[
    float | None,
    typer.Option(
        min=0, metavar="E", help="Ferrari-Canny margin of the contacts, at least.", rich_help_panel=CHOICE
    ),
]
MinLinks = Annotated[
    int | None,
    typer.Option(
        min=0, metavar="N", help="Finger links that touch after closing, at least.", rich_help_panel=CHOICE
    ),
]
HoldsIn = Annotated[
    str | None,
    typer.Option(
        metavar="ENGINE",
        help="Only grasps that hold in this engine too, by `verify --engine` (bullet, mujoco).",
        rich_help_panel=CHOICE,
    ),
]
RunDir = Annotated[Path, typer.Argument(metavar="DIR", help="A run's folder.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def worker_count(workers: int | None, *engines: str | None) -> int:
    """Return the number of workers that was given, else one per core, or one for a device."""
    return workers if workers is not None else 1 if DEVICE_ENGINE in engines else cores()


def given(**values: Any) -> dict[str, Any]:
    """Return the values that are not None."""
    return {name: value for name, value in values.items() if value is not None}


def resting_pose(text: str | None) -> int | str | None:
    """Parse the number of a resting pose, or `any`; raises ImpossibleValue for other text."""
    if text is None or text == ANY_RESTING_POSE:
        return text
    if text.isascii() and text.isdecimal() and int(text) < MOST_RESTING_POSES:
        return int(text)
    raise ImpossibleValue("--resting-pose", text, f"the number of a resting pose, or '{ANY_RESTING_POSE}'")


def preparation(simplify: int | None, remesh: bool, hull: bool, glued: bool) -> MeshPreparation | None:
    """Return the changes of a mesh that flags ask for; None without such a flag.

    Raises InputError for flags that exclude each other.
    """
    asked = MeshPreparation(simplify=simplify, remesh=remesh, hull=hull, glued=glued)
    if remesh and hull:
        raise InputError("--remesh and --hull each replace the mesh by another one: give one of them.")
    return None if asked == MeshPreparation() else asked


def host_and_port(text: str) -> tuple[str, int]:
    """Parse `127.0.0.1:8080` or `[::1]:8080`; raises ImpossibleValue for other text."""
    host, _, port = text.rpartition(":")
    if not (host and port.isdecimal() and int(port) < 1 << 16):
        raise ImpossibleValue("--web", text, "HOST:PORT, such as 127.0.0.1:8080")
    return host.removeprefix("[").removesuffix("]"), int(port)
