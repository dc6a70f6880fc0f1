"""Options of several commands; those of a spec take type and text from `RunSpec`."""

import functools
import inspect
import os
import tomllib
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer
from msgspec.inspect import FloatType, IntType, LiteralType, VarTupleType, type_info

from qdgrasp_assets.geometry.mesh_io import scale_of
from qdgrasp_coordinator.metrics.grasp_quality import GraspLimits
from qdgrasp_protocol.build_messages import MeshPreparation
from qdgrasp_protocol.cli_support import PROCESSES
from qdgrasp_protocol.errors import ImpossibleValue, UnknownName
from qdgrasp_protocol.spec import DEVICE_ENGINE, RunSpec, engine_names, key_texts, run_spec

SPEC, END, CHOICE = "Hand, object, search and evaluation", "End", "Choice of grasps"
"""Headings of options in the help of commands."""
KEY_TEXTS = key_texts()
KEY_TYPES = {field.name: type_info(field.type) for field in msgspec.structs.fields(RunSpec)}
PLAIN_TYPES = {LiteralType: str, IntType: int, FloatType: float, VarTupleType: list[str]}
FLAG_NAMES = {"scale": "units"}
"""Flags that are not called as the keys of a spec that they give."""
UNITS_HELP = "Unit of the mesh file: mm, cm, m or in, or how many metres it is; default m."
MESH_HELP = (
    "Changes of the mesh file: geometry=NAME (one of a scene), largest (its largest body alone), fill (small "
    "holes and flat rims), remesh (a new closed surface around it) or hull (its convex hull), glued (its "
    "bodies are one rigid object), simplify=N (at most N triangles); several separated by commas."
)
Units = Annotated[str | None, typer.Option(metavar="UNIT", help=UNITS_HELP, rich_help_panel=SPEC)]
Mesh = Annotated[str | None, typer.Option(metavar="CHANGES", help=MESH_HELP, rich_help_panel=SPEC)]


def _limit(kind: type[float], metavar: str, help_: str) -> Any:
    return Annotated[kind | None, typer.Option(min=0, metavar=metavar, help=help_, rich_help_panel=CHOICE)]


LIMITS: dict[str, Any] = {
    "max_penetration": _limit(float, "MM", "Deepest penetration after closing [mm], at most."),
    "max_motion": _limit(float, "MM", "Motion of the object in the hand while it closed [mm], at most."),
    "min_margin": _limit(float, "E", "Ferrari-Canny margin of the contacts, at least."),
    "min_links": _limit(int, "N", "Finger links that touch after closing, at least."),
}
"""Flags of `GraspLimits`, by its fields."""
FLAGS: dict[str, Any] = {"units": Units, "mesh": Mesh, **LIMITS}
"""Flags that are more than a value of their key."""
Sets = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Another key, of those listed below; repeatable.",
        rich_help_panel=SPEC,
    ),
]


def spec_flags(
    *names: str, sets: Collection[str] = KEY_TEXTS
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the flags of these keys of a spec, and --set for the others of `sets`.

    The command takes those that were given as the argument `keys`, values by key (`spec_values`).
    """
    flags = {name: FLAGS.get(name) or _flag(name) for name in names} | ({"set": Sets} if sets else {})

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(command)
        def called(**values: Any) -> None:
            command(keys=spec_values(given(**{name: values.pop(name) for name in flags}), sets), **values)

        known = inspect.signature(command, eval_str=True).parameters.values()
        added = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=flag)
            for name, flag in flags.items()
        ]
        kept = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in known if each.name != "keys"]
        first = [each for each in kept if each.default is inspect.Parameter.empty or each.name == "spec"]
        others = [each for each in kept if each not in first]
        signature = inspect.Signature([*first, *added, *others])
        called.__dict__["__signature__"] = signature
        called.__annotations__ = {each.name: each.annotation for each in signature.parameters.values()}
        others_set = [key for key in sets if FLAG_NAMES.get(key, key) not in signature.parameters]
        if others_set:
            lines = "\n\n".join(f"* {key}: {KEY_TEXTS[key]}" for key in others_set)
            called.__dict__["epilog"] = f"Keys for --set:\n\n{lines}"
        return called

    return decorate


def _flag(key: str) -> Any:
    info = KEY_TYPES[key]
    kinds = {type(each) for each in getattr(info, "types", (info,))}  # those of a union
    plain = next((plain for kind, plain in PLAIN_TYPES.items() if kind in kinds), str)
    flag = f"--{key.replace('_', '-')}"
    return Annotated[plain | None, typer.Option(flag, help=KEY_TEXTS[key], rich_help_panel=SPEC)]


def spec_values(flags: dict[str, Any], sets: Collection[str]) -> dict[str, Any]:
    """Return the spec values that flags give, by key; InputError for a key not in `sets`."""
    values: dict[str, Any] = {}
    for word in flags.pop("set", ()):
        key, _, text = word.partition("=")
        if key not in sets:
            raise UnknownName("key", key, sets, "Write --set KEY=VALUE.")
        values[key] = _parsed(text)
    values |= flags
    if units := values.pop("units", None):
        values["scale"] = scale_of_units(units)
    for key in ("mesh", "resting_pose"):
        if isinstance(values.get(key), str):
            values[key] = preparation(values[key]) if key == "mesh" else _parsed(values[key])
    return values


def _parsed(text: str) -> Any:
    """Return a number or a truth value as TOML has it, and any other text as it is."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def grasp_limits(keys: dict[str, Any]) -> GraspLimits:
    """Take the limits of grasps out of the values that flags give."""
    return GraspLimits(**{name: keys.pop(name, None) for name in LIMITS})


def scale_of_units(units: str | None) -> float | None:
    """Return the metres to a unit, by name or as a number; errors as of `scale_of`."""
    number = _parsed(units or "")
    return scale_of(number if isinstance(number, int | float) else units) if units else None


def preparation(text: str | None) -> MeshPreparation | None:
    """Return the changes of a mesh that --mesh lists; raises InputError for others."""
    if text is None:
        return None
    words = [word.strip().partition("=") for word in text.split(",")]
    said = {name: _parsed(value) if value else True for name, _, value in words}
    changes = said | {name: value for name, _, value in words if name == "geometry"}
    return run_spec({"gripper": "", "object": "", "mesh": changes}, "--mesh").mesh


SkipUnusable = Annotated[
    bool,
    typer.Option("--skip-unusable", help="Continue without objects that cannot be used, and report them."),
]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers", min=0, help="Worker processes; default: one per core.", rich_help_panel=PROCESSES
    ),
]
Seconds = Annotated[
    float | None,
    typer.Option(
        min=0,
        help="Stop after so many seconds; what is recorded stays, and can be continued.",
        rich_help_panel=END,
    ),
]
Listen = Annotated[
    str | None,
    typer.Option(
        help="Endpoint of the embedded router; default: port 7447 on loopback, or a free one.",
        rich_help_panel=PROCESSES,
    ),
]
Job = Annotated[
    str | None, typer.Option(help="Name on the bus; default: the folder's name.", rich_help_panel=PROCESSES)
]
RunDir = Annotated[Path, typer.Argument(metavar="DIR", help="A run's folder.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
Force = Annotated[bool, typer.Option("--force", help="Replace the output if it is there.")]


def is_robot_file(name: str) -> bool:
    """Return whether a gripper is named by its URDF or MJCF file, of which the rest is guessed."""
    return name.lower().endswith((".urdf", ".xacro", ".xml", ".mjcf", ".sdf"))


def scene_words(spec: RunSpec) -> str:
    """The hand, the object and the engines of a spec, for a person."""
    named = f"{spec.gripper} and {spec.object} in {' and '.join(engine_names(spec.engine))}"
    is_slow = spec.engine is None and spec.protocol != "released"
    return named + (" (--engine mujoco takes a third of the CPU time)" if is_slow else "")


def worker_count(workers: int | None, *engines: str | None) -> int:
    """Return the number of workers that was given, else one per core, or one for a device."""
    return workers if workers is not None else 1 if DEVICE_ENGINE in engines else len(os.sched_getaffinity(0))


def given(**values: Any) -> dict[str, Any]:
    """Return the values that are not None."""
    return {name: value for name, value in values.items() if value is not None}


def host_and_port(text: str) -> tuple[str, int]:
    """Parse `127.0.0.1:8080` or `[::1]:8080`; raises ImpossibleValue for other text."""
    host, _, port = text.rpartition(":")
    if not (host and port.isdecimal() and int(port) < 1 << 16):
        raise ImpossibleValue("--web", text, "HOST:PORT, such as 127.0.0.1:8080")
    return host.removeprefix("[").removesuffix("]"), int(port)
