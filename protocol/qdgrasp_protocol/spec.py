"""Specs of runs: frozen structs, read strictly from TOML or from flags.

`RunSpec` is the one definition of every key: its type, bounds and text, in files, flags and errors. A run
folder holds the full spec, so that `qdgrasp run DIR/spec.toml` repeats it. Workers are not part of a spec: no
result depends on them.
"""

import ast
import inspect
import re
import tomllib
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self, get_args

import msgspec
import tomli_w
from msgspec import Meta, Struct
from msgspec.inspect import NoneType

from qdgrasp_protocol.build_messages import MeshPreparation
from qdgrasp_protocol.errors import EXTRAS, ImpossibleValue, InputError, UnknownKey, check_packages
from qdgrasp_protocol.rows import (
    GIVEN,
    HARD_TRIALS,
    LIFT,
    TRIALS,
    disturbance_count,
    nominal_protocol,
    trial_count,
)

MAX_TOML_SIZE = 4 << 20
"""Most characters that are parsed; 4096 poses of a hand with 25 joints have two million."""
MAX_DOTS = 64  # The most dots between two separators of a line
SEPARATORS = re.compile(r"[,={\[]")


def parse_toml(text: str, where: str, most: int = MAX_TOML_SIZE) -> dict[str, Any]:
    """The values in a TOML text, which may come over the bus; else an InputError.

    `tomllib` remembers every beginning of a dotted key, so that 200 KB of `a.a.a` would take all memory.
    """
    if len(text) > most:
        raise InputError(f"{where} has {len(text)} characters, and none may have more than {most}.")
    if any(_dots_in_key(line) > MAX_DOTS for line in text.splitlines()):
        raise InputError(f"{where} has a key of more than {MAX_DOTS} parts.")
    try:
        return tomllib.loads(text)
    except ValueError as error:
        raise InputError(f"{where} is not TOML: {error}.") from None
    except RecursionError:
        raise InputError(f"{where} has lists in lists in lists without end.") from None


def _dots_in_key(line: str) -> int:
    return max(part.count(".") for part in SEPARATORS.split(line)) if line.count(".") > MAX_DOTS else 0


EngineName = Literal["bullet", "mujoco", "mujoco-fine", "mujoco-warp"]
"""The physics engines (docs/engines.md); `mujoco-fine` simulates `physical` in shorter steps."""
ENGINES: tuple[EngineName, ...] = get_args(EngineName)
EngineChoice = Literal[EngineName, "bullet,mujoco", "mujoco,bullet"]
"""An engine, or two: what holds in the first is tried in the second."""
DEFAULT_ENGINE = "bullet"  # Meant where a spec names none
DEVICE_ENGINE: Literal["mujoco-warp"] = "mujoco-warp"  # Of workers with a device alone
DEVICE_VARIABLE = "QDGRASP_DEVICE"  # Variable that names the device of workers
ENGINES_VARIABLE = "QDGRASP_ENGINES"  # Variable that names the engines of workers; not set: all
ENGINE_PACKAGES = {name: name for name in ENGINES} | {"bullet": "pybullet", "mujoco-fine": "mujoco"}


class MissingEngine(InputError):
    """Bullet is to simulate where PyBullet is not installed."""

    def __init__(self) -> None:
        super().__init__(
            "PyBullet is not installed: take --engine mujoco (not for the protocol released), or `pip "
            "install pybullet`, which from Python 3.12 on takes a C++ compiler and some ten minutes."
        )

    def __reduce__(self) -> tuple[type[Self], tuple[()]]:
        """Come out of another process as it is."""
        return type(self), ()


def engine_names(engine: str | None) -> tuple[str, ...]:
    """The engines that a spec or scene names, in the order in which a grasp is tried in them."""
    return tuple((engine or DEFAULT_ENGINE).split(","))


def has_bullet() -> bool:
    """Return whether PyBullet is installed here."""
    return find_spec("pybullet") is not None


def usual_engine(protocol: str | None = None) -> dict[str, str]:
    """The engine to add to a spec that a person wrote; a recorded spec without one is in Bullet."""
    return {} if has_bullet() or protocol == "released" else {"engine": "mujoco"}


def check_engine(engine: str | None) -> None:
    """Raise `MissingEngine` if Bullet (None) is among these, and PyBullet is not installed here."""
    if DEFAULT_ENGINE in engine_names(engine) and not has_bullet():
        raise MissingEngine


MOST_WORLDS = 4096  # Most genomes of a generation
CPU_WORLDS = 64  # On warp's CPU device, which is for tests


class Device(NamedTuple):
    """A device that evaluates many rows together."""

    name: str
    """Its name in warp: cpu, cuda, cuda:1."""
    worlds: int
    """Rows that it evaluates at once."""

    @classmethod
    def find(cls, name: str, worlds: int | None = None) -> Self:
        """A device by its name; None: as many worlds as fill it. An InputError without the packages."""
        check_packages(f"--device {name}", *EXTRAS["gpu"])
        return cls(name, worlds or (CPU_WORLDS if name == "cpu" else MOST_WORLDS))


ProtocolName = Literal["paper", "released", "robust", "physical", "lift"]
"""The evaluation protocols (docs/protocols.md)."""
BaseName = Literal["paper", "physical"]
"""The protocols that the trials of `robust` disturb."""
Overlaps = Literal["count", "redraw"]
"""Treatment of poses whose open hand overlaps the object: counted as evaluations or redrawn."""


AimFor = Literal["hold", "touch"]
"""Objectives of the default search: grasps that survive all disturbances, or contact after closing."""
DiversityName = Literal["position", "orientation", "contact"]
"""Features that tell grasps apart: the hand's cell; its orientation bin too; contacts and the hand's side."""

APPROACH_DISTANCE = 0.1
"""Distance from which a hand has to come where there is a table, unless another is said [m].

About the reach of a hand such as the Panda, 0.112 m: so far back open fingers are clear of what they grasp.
"""
ANY_RESTING_POSE = "any"
"""Stands for all resting poses of an object: the hand has to come above the table in one of them at least."""
MOST_RESTING_POSES = 100  # Each has a hundredth of all probability at least

DEFAULT_METHOD = "portfolio"
MAX_POPULATION = 4096  # Genomes in a generation, at most, and poses in a spec


NoteText = Annotated[str, Meta(max_length=500)]


class ObjectRecord(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """The description of an object by its library; no result depends on it. Empty: not said."""

    id: NoteText = ""
    """Name of the object, in place of its file's."""
    category: NoteText = ""
    licence: NoteText = ""
    source: NoteText = ""
    """Origin of the mesh, such as a data set or an address."""
    split: NoteText = ""
    """Part of a data set, such as train or test."""


GOAL_KEYS = ("grasps", "saturation")
"""Keys of a spec's stop criteria besides its budget."""
STOP_KEYS = ("evaluations", *GOAL_KEYS)
"""Keys of a spec's stop criteria, which may change when a run goes on."""

TABLE_KEYS = ("mesh", "about")
"""Keys of a spec whose values are tables, which stand last in TOML."""
UNTYPED_KEYS = ("about", "poses", "reseated")
"""Keys that nobody types: files and other commands give them."""
OBJECTIVE_KEYS = ("aim_for", "diversity")
"""Keys of a spec that only the method with an objective has."""

OWN_SEARCH = "custom_"
"""Beginning of the names of methods that stand for a program's own search."""


class RunSpec(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=False):
    """One search: scene, method, seed and budget.

    When a run is asked for, its method decides `aim_for`, `overlaps`, `population`, `generations_in_flight`
    and `in_flight` unless they are given; their defaults here are the paper's. The line below each key is its
    help on the command line too (`key_texts`).
    """

    gripper: str
    """A built-in gripper, one on the asset path, or a gripper's file (TOML; in run a URDF, MJCF)."""
    object: str
    """A built-in object, one on the asset path, or a mesh file."""
    mass: Annotated[float, Meta(gt=0, le=1000)] | None = None
    """Mass of the object [kg]; default: the catalog's. Mesh files have none; run takes 500 kg/m3."""
    scale: Annotated[float, Meta(gt=0, le=1_000_000)] | None = None
    """Metres to a unit of the object's mesh file, 0.001 for mm; default 1."""
    friction: Annotated[float, Meta(gt=0, le=10)] | None = None
    """Lateral friction coefficient of the object; default 0.5, the paper's."""
    mesh: MeshPreparation | None = None
    """Changes of the object's mesh file; default: taken as it is."""
    about: ObjectRecord | None = None
    """The object's description by its library; default: its file's name is all that is known."""
    method: str = DEFAULT_METHOD
    """A search with its prior; `qdgrasp methods` lists them."""
    protocol: ProtocolName = "paper"
    """Evaluation protocol; default physical of `run` and of a campaign of meshes, else paper."""
    base: BaseName = "paper"
    """Protocol that the trials of `robust` disturb; no other protocol has one."""
    engine: EngineChoice | None = None
    """Physics engine, or two: what holds in the first is tried in the second; default bullet, else mujoco."""
    approach_distance: Annotated[float, Meta(ge=0, le=1)] | None = None
    """Way [m] on which the open hand comes along its approach axis; default 0, with table or scene 0.1."""
    resting_pose: Annotated[int, Meta(ge=0, lt=MOST_RESTING_POSES)] | Literal["any"] | None = None
    """How the object rests on a table, by `qdgrasp asset resting-poses`; default: no table."""
    scene: str | None = None
    """A file of the fixed bodies around the object (docs/where.md); default: there are none."""
    on: tuple[str, ...] | None = None
    """Region of the object that all contacts have to be in, or several (docs/where.md); default: anywhere."""
    avoid: tuple[str, ...] | None = None
    """Region of the object that no contact may be in, or several."""
    trials: Annotated[int, Meta(ge=1, le=TRIALS + HARD_TRIALS)] | None = None
    """Trials of each success under `robust`, of given poses 20 harder ones beyond 100; default 100."""
    aim_for: AimFor | None = None
    """Objective of the method portfolio."""
    diversity: DiversityName | None = None
    """Features that tell grasps apart in a search with an objective; default position."""
    evaluations: Annotated[int, Meta(ge=1, le=10**9)] = 10_000
    """The budget: counted evaluations."""
    grasps: Annotated[int, Meta(ge=1, le=10**9)] | None = None
    """End with so many grasps (fitness 1 or more)."""
    saturation: Annotated[float, Meta(ge=0, lt=1)] | None = None
    """End when new niches come at this share of the run's mean rate; 0: never."""
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    """Seed of the search."""
    overlaps: Overlaps = "count"
    """Poses whose open hand overlaps the object count as evaluations, or are drawn again."""
    population: Annotated[int, Meta(ge=1, le=MAX_POPULATION)] = 500
    """Genomes in a generation (the paper's mu = lambda)."""
    mutation_sigma: Annotated[float, Meta(gt=0, le=2)] = 0.1
    """Standard deviation of the Gaussian mutation, in genes."""
    mutation_probability: Annotated[float, Meta(gt=0, le=1)] = 0.3
    """The probability that a gene mutates."""
    generations_in_flight: Annotated[int, Meta(ge=1, le=16)] = 1
    """Generation g is asked when generation g minus this has been told; where the number grows, at first."""
    in_flight: Annotated[int, Meta(ge=1, le=100_000)] | None = None
    """Most genomes in flight, where generations in flight become more as more are told."""
    surface_seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    """Seed of the surface points, part of the scene."""
    poses: Annotated[tuple[tuple[float, ...], ...], Meta(min_length=1, max_length=MAX_POPULATION)] | None = (
        None
    )
    """Hand poses for the method `given`: x y z [m], qx qy qz qw, then synergy label and free joints [rad]."""
    reseated: tuple[Annotated[int, Meta(ge=0, lt=MAX_POPULATION)], ...] | None = None
    """Places of the poses at which the open hand of an earlier evaluation had settled; none: not tried."""

    @property
    def has_own_search(self) -> bool:
        """True if a program's own search asked its genomes; the spec does not say which one."""
        return self.method.startswith(OWN_SEARCH)

    @property
    def nominal_protocol(self) -> str:
        """The protocol of its nominal evaluations: the one that `robust` disturbs, else its own."""
        return nominal_protocol(self.protocol, self.base)

    @property
    def table_pose(self) -> int | str | None:
        """The resting pose on a table: as asked, in `lift` the likeliest where none is."""
        return 0 if self.protocol == LIFT and self.resting_pose is None else self.resting_pose

    @property
    def approach(self) -> float:
        """Distance from which the open hand has to come to its pose [m]; 0: it is set there."""
        usual = 0.0 if self.table_pose is None and self.scene is None else APPROACH_DISTANCE
        return usual if self.approach_distance is None else self.approach_distance

    @property
    def protocol_words(self) -> str:
        """The protocol, and its engine or engines where that is not Bullet alone."""
        engines = " then ".join(engine_names(self.engine))
        return f"{self.protocol} in {engines}" if self.engine else self.protocol

    @property
    def disturbances(self) -> int:
        """Disturbances in one evaluation: the fitness of a grasp that survives them all."""
        return disturbance_count(self.nominal_protocol)

    @property
    def trial_count(self) -> int:
        """Trials of each success; 0 where the protocol has none."""
        return self.trials or trial_count(self.protocol)


def run_spec(values: dict[str, Any], where: str = "spec") -> RunSpec:
    """Make a spec of plain values.

    Raises `UnknownKey` for a key that no field has, `ImpossibleValue` for a value of the wrong type or
    outside what the field allows, and `InputError` where `gripper` or `object` is missing.
    """
    try:
        spec = msgspec.convert(values, RunSpec)
    except msgspec.ValidationError:
        raise _spec_fault(values, where) from None
    if spec.base != "paper" and spec.protocol != "robust":
        raise InputError(
            f"{where}: base = '{spec.base}' says what the trials of the protocol 'robust' disturb, and "
            f"'{spec.protocol}' has no trials; leave base out, or take protocol = 'robust'."
        )
    if spec.trials is not None and not trial_count(spec.protocol):
        raise InputError(
            f"{where}: trials = {spec.trials} is for the protocol 'robust', and '{spec.protocol}' has no "
            "trials; leave trials out, or take protocol = 'robust'."
        )
    if (spec.trials or 0) > TRIALS and (spec.base != "physical" or spec.method != GIVEN):
        expected = f"at most {TRIALS}, unless base = 'physical' and method = '{GIVEN}'"
        raise ImpossibleValue(f"{where}: trials", spec.trials, expected)
    if spec.mesh is not None and spec.mesh.remesh and spec.mesh.hull:
        raise InputError(f"{where}: remesh and hull each replace the mesh by another one; take one of them.")
    if spec.protocol == LIFT and spec.resting_pose == ANY_RESTING_POSE:
        raise InputError(
            f"{where}: the protocol '{LIFT}' lifts the object from one resting pose; say its number with "
            "resting_pose, or leave that out for the likeliest one."
        )
    if spec.engine == DEFAULT_ENGINE:
        return msgspec.structs.replace(spec, engine=None)
    if spec.engine and spec.protocol == "released":
        raise InputError(
            f"{where}: the protocol 'released' repeats the authors' code, which is Bullet's, and engine = "
            f"'{spec.engine}'; leave engine out, or take the protocol 'paper'."
        )
    if spec.engine == DEVICE_ENGINE and spec.approach:
        raise InputError(
            f"{where}: engine = '{spec.engine}' does not look at the way of a hand to its pose; take "
            "engine = 'mujoco', or approach_distance = 0."
        )
    if spec.engine == DEVICE_ENGINE and spec.nominal_protocol != "physical":
        raise InputError(
            f"{where}: engine = '{spec.engine}' simulates the protocol 'physical', and 'robust' with base = "
            f"'physical', and this is '{spec.protocol}'; take one of these, or engine = 'mujoco'."
        )
    return spec


def _spec_fault(values: dict[str, Any], where: str) -> InputError:
    """Return the error for values of which no spec can be made."""
    fields = {field.name: field for field in msgspec.structs.fields(RunSpec)}
    for key in values:
        if key not in fields:
            return UnknownKey(where, key, fields)
    for field in fields.values():
        if field.required and field.name not in values:
            return InputError(
                f"{where}: '{field.name}' is missing; name one with --{field.name} or in the spec."
            )
    for key, value in values.items():
        try:
            msgspec.convert(value, fields[key].type)
        except msgspec.ValidationError:
            return ImpossibleValue(f"{where}: {key}", value, _expected_value(fields[key].type))
    return InputError(f"{where}: no spec can be made of these values.")


def read_run_spec(path: Path, most: int = MAX_TOML_SIZE) -> dict[str, Any]:
    """The values in a TOML file, not yet checked; an InputError if it cannot be read as TOML.

    It may have `most` characters.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"No spec can be read at '{path}': {getattr(error, 'strerror', error)}.") from None
    return parse_toml(text, str(path), most)


def from_toml(text: str, where: str = "spec") -> RunSpec:
    """The spec in a TOML text; the inverse of `to_toml`. Errors are those of `run_spec`."""
    return run_spec(parse_toml(text, where), where)


def differences(one: RunSpec, other: RunSpec) -> list[str]:
    """Return the keys in which two specs differ, without the stop criteria."""
    return [
        key
        for key in one.__struct_fields__
        if key not in STOP_KEYS and getattr(one, key) != getattr(other, key)
    ]


def to_values(spec: RunSpec) -> dict[str, Any]:
    """Return the full spec as plain values, without fields that have no value."""
    values = msgspec.structs.asdict(spec)
    return {key: msgspec.to_builtins(value) for key, value in values.items() if value is not None}


def to_toml(spec: RunSpec) -> str:
    """Return the full spec as TOML, without fields that have no value; each pose on a line."""
    values = to_values(spec)
    poses = values.pop("poses", ())
    tables = {key: values.pop(key) for key in TABLE_KEYS if key in values}
    lines = "".join(f"    [{', '.join(map(repr, pose))}],\n" for pose in poses)
    return tomli_w.dumps(values) + (f"poses = [\n{lines}]\n" if poses else "") + tomli_w.dumps(tables)


def key_texts() -> dict[str, str]:
    """Return the help of each key that a person may type: its text and its values."""
    (body,) = ast.parse(inspect.getsource(RunSpec)).body
    said = [
        str(node.value.value)
        for node in ast.walk(body)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    ]
    keys = msgspec.structs.fields(RunSpec)
    texts = zip(keys, said[1 : len(keys) + 1], strict=True)  # the first is that of the class
    return {
        key.name: f"{text} [{_expected_value(key.type)}]"
        for key, text in texts
        if key.name not in UNTYPED_KEYS
    }


NOUNS = {
    msgspec.inspect.StrType: "text",
    msgspec.inspect.BoolType: "true or false",
    msgspec.inspect.IntType: "a whole number",
    msgspec.inspect.FloatType: "a number",
}
VAST = 10**9  # A bound that nobody comes to, and that is not said
BOUNDS = {"ge": "at least", "gt": "greater than", "le": "at most", "lt": "less than"}


def _expected_value(kind: Any) -> str:
    """A field's type in words."""
    return _type_words(msgspec.inspect.type_info(kind))


def _type_words(info: msgspec.inspect.Type) -> str:
    match info:
        case msgspec.inspect.UnionType():
            return ", or ".join(_type_words(each) for each in info.types if not isinstance(each, NoneType))
        case msgspec.inspect.LiteralType():
            return "one of " + ", ".join(map(repr, info.values))
        case msgspec.inspect.VarTupleType(item_type=msgspec.inspect.StrType()):
            return "a list of texts"
        case msgspec.inspect.VarTupleType():
            is_list = isinstance(info.item_type, msgspec.inspect.FloatType)
            return "a list of numbers" if is_list else "lists of numbers"
        case msgspec.inspect.StructType():
            return (
                f"a table of {', '.join(f'{each.name} ({_type_words(each.type)})' for each in info.fields)}"
            )
    bounds = {word: getattr(info, name, None) for name, word in BOUNDS.items()}
    limits = [f"{word} {limit}" for word, limit in bounds.items() if limit is not None and limit < VAST]
    return f"{NOUNS[type(info)]} {' and '.join(limits)}".strip()
