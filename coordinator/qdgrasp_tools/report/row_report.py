"""Report on one row of a journal, and the context that its columns are read in.

The context says which synergy a genome chose and how many trials a success has.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_assets.grippers.urdf import parse_robot
from qdgrasp_assets.scene import Scene, SceneGripper
from qdgrasp_coordinator.metrics.cells import UNKNOWN_GENOMES, GenomeReader, cells
from qdgrasp_coordinator.metrics.grasp_quality import object_motion, recorded_margins
from qdgrasp_coordinator.metrics.successes import TrialPlan, eta_error
from qdgrasp_coordinator.search.registry import prior_of
from qdgrasp_coordinator.storage.engine_table import other_tables, verdicts
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.run_folder import RunFolder, provenance
from qdgrasp_coordinator.storage.success_pages import RowContext
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import CONTACT_VALUES, Outcome

MOST_CONTEXTS = 256  # So many are kept, a few hundred bytes each
ContextKey = tuple[Path, float, str]
"""Folder of a run; of its journal: time of creation, and scene."""


class RowContextCache:
    """Contexts of the rows of journals, a few hundred at most; any thread may ask."""

    def __init__(self) -> None:
        self._known: dict[ContextKey, RowContext] = {}

    def get(self, folder: RunFolder, journal: Journal) -> RowContext:
        """Return that of a run's journal; FolderError if its scene cannot be read."""
        name = (folder.path, journal.created, journal.scene)
        if name in self._known:
            return self._known[name]
        if len(self._known) >= MOST_CONTEXTS:
            self._known.clear()
        made = row_context(folder, journal)
        if folder.has_bundle():
            self._known[name] = made
        return made


def row_context(folder: RunFolder, journal: Journal) -> RowContext:
    """Make the context of a run's journal; without its scene it names no synergies."""
    return RowContext(TrialPlan.of(folder.spec), genome_reader(folder))


POSE_FRAME = "object's centre-of-mass frame"
OUTCOME_MEANINGS = {
    Outcome.ERROR: "the simulator failed three times",
    Outcome.DEAD_END: "there was no pose to simulate",
    Outcome.OVERLAP: "the open hand overlaps the object",
    Outcome.MISSED: "no finger touched the object",
    Outcome.BRUSHED: "a finger touched while closing, none after it",
    Outcome.DROPPED: "a finger touches after closing; no disturbance was survived",
    Outcome.SHAKEN: "some of the disturbances were survived",
    Outcome.HELD: "every disturbance was survived",
}


class NoSuchRow(InputError):
    """A number that no row of a journal has."""

    def __init__(self, folder: Path, number: int, rows: int) -> None:
        there = f"it has {rows}, numbered from 0" if rows else "it has none yet"
        super().__init__(f"The journal of {folder} has no row {number}: {there}.")


class ReportedPose(Struct, frozen=True, kw_only=True):
    """Pose of the hand."""

    link: str
    """The hand's root link, which has the pose."""
    frame: str
    position: tuple[float, ...]
    """x, y, z [m]."""
    quaternion_xyzw: tuple[float, ...]


class JointPosition(Struct, frozen=True, kw_only=True):
    """Position of a finger joint after closing."""

    name: str
    position: float
    unit: str
    """"rad", or "m" of a joint that slides."""


class ReportedContact(Struct, frozen=True, kw_only=True):
    """A contact of hand and object after closing, object's CoM frame."""

    link: str
    """The hand's link."""
    point: tuple[float, ...]
    """x, y, z [m], on the object."""
    normal: tuple[float, ...]
    """Unit, into the object."""
    force: float
    """Along the normal [N]."""


class GeneValue(Struct, frozen=True, kw_only=True):
    """One component of a genome."""

    name: str
    gene: float
    """Gene in [-1, 1]; under the prior `given` the value itself."""
    value: float
    """The length or angle that it stands for [m or rad]."""


class RowReport(Struct, frozen=True, kw_only=True):
    """All that is known about one row; positions are metres in the object's CoM frame."""

    folder: str
    """Folder of the run."""
    number: int
    """Number of the row in the journal, as the view in 3D counts."""
    rows: int
    generation: int
    index: int
    trial: int
    """0: the nominal evaluation; 1 and up: domain-randomised."""
    outcome: str
    """`Outcome` by its name in lower case."""
    meaning: str
    reason: str
    """Reason of an error; else empty."""
    fitness: float
    """Disturbances survived."""
    eta: float | None
    """The estimated probability of transfer; None where too few trials of a success are there."""
    eta_error: float | None
    """Its standard error, for the number of trials alone."""
    trials: int
    """Trials of it that are recorded."""
    descriptor: tuple[float, ...]
    """The hand's commanded position [m], then what the prior tells beside it."""
    cell: tuple[int, ...] | None
    """Cell of 1 cm; None where there is no pose."""
    base_to_object: ReportedPose | None
    """The commanded pose, before closing; None where there was no pose."""
    settled: ReportedPose | None
    """The settled pose, after closing: with `joints`; None where it is not recorded."""
    moved: float | None
    """How far the object's centre of mass moved in the hand while it closed [m]; None as `settled`."""
    turned: float | None
    """How far the object turned in the hand while it closed [rad]; None as `settled`."""
    margin: float | None
    """Ferrari-Canny margin of the contacts; None as `settled`."""
    joints: tuple[JointPosition, ...]
    """Finger joints after closing; none where the hand did not close."""
    synergy: str
    """The synergy that closed the hand; empty: all driven joints."""
    surface_point: tuple[float, ...] | None
    """The surface point aimed at [m]; None without an aim."""
    nu: float | None
    """Angle between its normal and the direction to the hand [rad]; None without an aim."""
    contacts: int
    """Finger links that touch the object after closing."""
    penetration: float
    """Deepest penetration after closing [m], 0 or positive."""
    contact_points: tuple[ReportedContact, ...]
    """Contacts after closing, some of them where there were many; none where they are not recorded."""
    gripper: str
    object: str
    protocol: str
    method: str
    prior: str
    """The rule that decodes the genome."""
    seed: int
    genome: tuple[GeneValue, ...]
    scene: str
    """sha256 of the scene bundle."""
    com_in_mesh: tuple[float, ...]
    """The centre of mass in the mesh file's frame [m]: position in the mesh = position + this."""
    scale: float
    """Metres to a unit of the mesh file."""
    run: str
    """The run that found it, by the name of its folder."""
    elsewhere: dict[str, str] = {}
    """Outcome and fitness in other engines that the run has a table of, in words."""

    @property
    def table(self) -> str:
        """All fields in words, one to a line, and one for each item of a list."""
        values = msgspec.to_builtins(self)
        return "\n".join(line for name, value in values.items() for line in _lines(name, value))


UNITS = dict.fromkeys(("penetration", "moved", "com_in_mesh", "surface_point"), "m") | {
    "turned": "rad",
    "nu": "rad",
}
"""Units of fields, where these have one."""


def _lines(name: str, value: object) -> Iterator[str]:
    """Yield a field in words."""
    items = value if isinstance(value, tuple) and value and isinstance(value[0], dict) else (value,)
    for place, item in enumerate(items):
        unit = "" if item is None else f" {UNITS.get(name, '')}".rstrip()
        yield f"{name.replace('_', ' ') if not place else '':<16} {_words(item)}{unit}"


def _words(value: object) -> str:
    match value:
        case dict() if value:
            return "  ".join(f"{name} {_words(one)}" for name, one in value.items())
        case tuple() if value:
            return " ".join(map(_words, value))
        case None | "" | () | dict():
            return "none"
        case float():
            return f"{value:.6g}"
    return str(value)


def row_report(folder: RunFolder, number: int) -> RowReport:
    """Report a row by its number in the journal, also while the run goes on.

    Raises NoSuchRow, or FolderError if the folder cannot be read.
    """
    with folder.journal() as journal:
        row = row_at(folder, journal, number)
        found_by = provenance(folder, journal)
        spec, behind = found_by.spec, range(number + 1, journal.count)
        plan = TrialPlan.of(spec)
        repeats = _trial_fitness(journal, row, behind, plan.trials)
        values: dict[str, object] = {
            "folder": str(folder.path),
            "run": found_by.run,
            "number": number,
            "rows": journal.count,
            "scene": journal.scene,
            "reason": journal.errors().get(number, ""),
        }
    values |= {name: getattr(spec, name) for name in ("gripper", "object", "protocol", "method", "seed")}
    values |= _row_fields(row, folder.scene(), prior_of(spec))
    values["elsewhere"] = _other_verdicts(folder, number, row)
    values |= {"scale": spec.scale or 1.0, "trials": len(repeats), "eta": None, "eta_error": None}
    if 0 < plan.trials <= len(repeats):
        count = np.array([len(repeats)])
        found = plan.eta(np.array([sum(repeats)]))
        values |= {"eta": float(found[0]), "eta_error": float(eta_error(found, count)[0])}
    return msgspec.convert(values, RowReport)


def _other_verdicts(folder: RunFolder, number: int, row: np.void) -> dict[str, str]:
    """Outcome and fitness of a success in other engines, in words."""
    found = {}
    for name, table in other_tables(folder).items():
        (verdict,) = verdicts(table, np.array([number]), row["outcome"][None])
        if verdict["outcome"] >= 0:
            found[name] = f"{Outcome(verdict['outcome']).name.lower()}, fitness {verdict['fitness']:g}"
    return found


def row_at(folder: RunFolder, journal: Journal, number: int) -> np.void:
    """Return the row of a number in a folder's journal; raises NoSuchRow."""
    if not 0 <= number < journal.count:
        raise NoSuchRow(folder.path, number, journal.count)
    row: np.void = np.concatenate(list(journal.blocks(number, number + 1)))[0]
    return row


def _row_fields(row: np.void, scene: Scene, prior: str) -> dict[str, object]:
    outcome, is_aimed = Outcome(row["outcome"]), bool(row["surface_point"].any())
    pose, label = (
        _pose(row["base_to_object"], scene.gripper),
        int(GenomeReader.of(scene, prior).labels(row["genome"][None])[0]),
    )
    plain = ("generation", "index", "trial", "fitness", "descriptor", "contacts", "penetration")
    return {name: row[name].tolist() for name in plain} | {
        "outcome": outcome.name.lower(),
        "meaning": OUTCOME_MEANINGS[outcome],
        "cell": cells(row["descriptor"][:3]).tolist() if pose else None,
        "base_to_object": pose,
        **_closing_fields(row, scene),
        "joints": list(_joints(row, scene.gripper)) if outcome.is_simulated else [],
        "synergy": scene.gripper.synergies[label].name if label >= 0 else "",
        "surface_point": row["surface_point"].tolist() if is_aimed else None,
        "nu": float(row["nu"]) if is_aimed else None,
        "prior": prior,
        "genome": list(_gene_values(row, scene, prior)),
        "com_in_mesh": scene.object.com_in_mesh,
    }


def _trial_fitness(journal: Journal, row: np.void, behind: range, most: int) -> list[float]:
    """Return the fitness in each trial of a nominal success; trials stand behind it."""
    found: list[float] = []
    if not most or row["trial"] or not Outcome(row["outcome"]).is_success:
        return found
    for rows in journal.blocks(behind.start, behind.stop) if behind else ():
        is_same = (rows["generation"] == row["generation"]) & (rows["index"] == row["index"])
        found += rows["fitness"][is_same & (rows["trial"] > 0)].tolist()
        if len(found) >= most or rows["generation"][-1] != row["generation"]:
            break
    return found


def _closing_fields(row: np.void, scene: Scene) -> dict[str, object]:
    moved, turned = object_motion(row.reshape(1))[0].tolist()
    (margin,) = recorded_margins(row.reshape(1), scene.object).tolist()
    settled = _pose(row["settled"], scene.gripper)
    return {
        "settled": settled,
        "moved": moved if settled else None,
        "turned": turned if settled else None,
        "margin": margin if settled else None,
        "contact_points": list(_contacts(row, scene.gripper)),
    }


def _contacts(row: np.void, gripper: SceneGripper) -> Iterator[ReportedContact]:
    values = row["contact_points"].astype(float).reshape(-1, CONTACT_VALUES).tolist()
    for link, (*vectors, force) in zip(row["contact_links"].tolist(), values, strict=True):
        if link:
            yield ReportedContact(
                link=gripper.links[link - 1], point=tuple(vectors[:3]), normal=tuple(vectors[3:]), force=force
            )


def _pose(values: NDArray[np.float32], gripper: SceneGripper) -> ReportedPose | None:
    pose = values.tolist()
    if not any(pose[3:]):
        return None
    return ReportedPose(
        link=gripper.base_link, frame=POSE_FRAME, position=tuple(pose[:3]), quaternion_xyzw=tuple(pose[3:])
    )


def _joints(row: np.void, gripper: SceneGripper) -> Iterator[JointPosition]:
    robot = parse_robot(Path(gripper.name), ET.fromstring(gripper.urdf))  # noqa: S314  # a scene that was checked
    for joint, position in zip(gripper.joints, row["joints"].tolist(), strict=False):
        found = robot.joint(joint.name)
        slides = found is not None and found.kind == "prismatic"
        yield JointPosition(name=joint.name, position=position, unit="m" if slides else "rad")


def _gene_values(row: np.void, scene: Scene, prior: str) -> Iterator[GeneValue]:
    known = GenomeReader.of(scene, prior)
    (values,) = known.values(row["genome"][None]).tolist()
    for name, gene, value in zip(known.layout.names, row["genome"].tolist(), values, strict=False):
        yield GeneValue(name=name, gene=gene, value=value)


def genome_reader(folder: RunFolder) -> GenomeReader:
    """Return the reader of a run's genomes; without its scene all synergies are one."""
    return GenomeReader.of(folder.scene(), prior_of(folder.spec)) if folder.has_bundle() else UNKNOWN_GENOMES
