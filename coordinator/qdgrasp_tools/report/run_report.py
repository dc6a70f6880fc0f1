"""Reports on a run and on one row of it, and the context that its columns are read in.

The context says which synergy a genome chose and how many trials a success has.
"""

from collections import Counter
from collections.abc import Iterator
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import field, structs
from numpy.typing import NDArray

from qdgrasp_assets.grippers.hand_model import coupling_error
from qdgrasp_assets.grippers.urdf import scene_robot
from qdgrasp_assets.scene import Scene, SceneGripper
from qdgrasp_coordinator.metrics.cells import UNKNOWN_GENOMES, GenomeReader, cells, niches
from qdgrasp_coordinator.metrics.grasp_quality import object_motion, recorded_margins
from qdgrasp_coordinator.metrics.job_status import RunListing
from qdgrasp_coordinator.metrics.run_stats import RunCounter
from qdgrasp_coordinator.metrics.success_metrics import (
    Diversity,
    EtaSummary,
    NuSummary,
    SuccessMetrics,
    diversity,
)
from qdgrasp_coordinator.metrics.successes import (
    Successes,
    TrialPlan,
    eta_error,
    find_successes,
    join_successes,
)
from qdgrasp_coordinator.search.registry import prior_of
from qdgrasp_coordinator.storage.engine_table import HeldShare, held_shares, other_tables, verdicts
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.run_folder import RunFolder, provenance
from qdgrasp_coordinator.storage.success_pages import RowContext
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import CONTACT_VALUES, Outcome
from qdgrasp_protocol.spec import DEFAULT_ENGINE
from qdgrasp_protocol.text import counted

MOST_CONTEXTS = 256  # So many are kept, a few hundred bytes each


def row_context(folder: RunFolder, journal: Journal) -> RowContext:
    """Return the context of a journal's rows, kept; FolderError if its scene cannot be read."""
    return _context(folder.path, journal.created, journal.scene, folder.has_bundle())


@lru_cache(MOST_CONTEXTS)
def _context(path: Path, _created: float, _scene: str, _has_bundle: bool) -> RowContext:
    return RowContext(TrialPlan.of(RunFolder(path).spec), genome_reader(RunFolder(path)))


POSE_FRAME = "object's centre-of-mass frame"
OUTCOME_MEANINGS = {
    Outcome.ERROR: "the simulator failed three times",
    Outcome.DEAD_END: "there was no pose to simulate",
    Outcome.OVERLAP: "the open hand overlaps the object",
    Outcome.MISSED: "no finger touched the object",
    Outcome.BRUSHED: "a finger touched while closing, none after it, or one outside the region",
    Outcome.DROPPED: "a finger touches after closing; no disturbance was survived",
    Outcome.SHAKEN: "some of the disturbances were survived",
    Outcome.HELD: "every disturbance was survived",
}


class NoSuchRow(InputError):
    """A number that no row of a journal has."""

    def __init__(self, folder: Path, number: int, rows: int) -> None:
        there = f"it has {rows}, numbered from 0" if rows else "it has none yet"
        super().__init__(f"The journal of {folder} has no row {number}: {there}.")


UNITS = dict.fromkeys(("penetration", "moved", "com_in_mesh", "surface_point"), "m") | {
    "turned": "rad",
    "nu": "rad",
}
"""Units of fields, where these have one."""


def report_table(report: dict[str, Any]) -> str:
    """Return a report in words: a line for each field, or for each item of some lists."""
    return "\n".join(line for name, value in report.items() for line in _lines(name, value))


def _lines(name: str, value: object) -> Iterator[str]:
    """Yield a field in words."""
    items = value if isinstance(value, list) and value and isinstance(value[0], dict | str) else (value,)
    for place, item in enumerate(items):
        unit = "" if item is None else f" {UNITS.get(name, '')}".rstrip()
        yield f"{name.replace('_', ' ') if not place else '':<16} {_words(item)}{unit}"


def _words(value: object) -> str:
    match value:
        case dict() if value:
            return "  ".join(f"{name} {_words(one)}" for name, one in value.items())
        case list() if value:
            return " ".join(map(_words, value))
        case None | "" | [] | dict():
            return "none"
        case float():
            return f"{value:.6g}"
    return str(value)


def row_report(folder: RunFolder, number: int) -> dict[str, Any]:
    """Return all that is known about a row, by its number in the journal.

    Plain values by name: positions [m] in the object's CoM frame, angles [rad], forces [N]; None where there
    is nothing. Raises NoSuchRow, or FolderError if the folder cannot be read.
    """
    with folder.journal() as journal:
        row = row_at(folder, journal, number)
        found_by = provenance(folder, journal)
        spec, plan = found_by.spec, TrialPlan.of(found_by.spec)
        is_tried = plan.trials and row["trial"] == 0 and Outcome(row["outcome"]).is_success
        found = find_successes(journal.blocks(number) if is_tried else (), plan, first=number)
        success = next(filter(len, found), None)
        counts = {"number": number, "rows": journal.count}
        digest, reason = journal.scene, journal.errors().get(number, "")
        makers = journal.makers(number, number + 1)
    scene, prior = folder.scene(), prior_of(spec)
    eta = np.array(plan.eta(success.scores)[0] if success else np.nan)
    return {
        "folder": str(folder.path),
        "run": found_by.run,
        **counts,
        **_row_fields(row, scene, prior),
        "reason": reason,  # of an error
        "made_by": " on ".join(makers[0][2:]) if makers else None,  # a worker's id and host
        "trials": int(success.trials[0]) if success else 0,  # that are recorded
        "eta": known(eta),  # the estimated probability of transfer, once all trials are there
        "eta_error": known(eta_error(eta, np.array(plan.usual))),  # for the number of trials alone
        "elsewhere": _other_verdicts(folder, number, row),
        **{name: getattr(spec, name) for name in ("gripper", "object", "protocol", "method", "seed")},
        "prior": prior,
        "scene": digest,  # sha256 of the bundle
        "com_in_mesh": list(scene.object.com_in_mesh),
        "scale": spec.scale or 1.0,  # metres to a unit of the mesh file
    }


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


def _row_fields(row: np.void, scene: Scene, prior: str) -> dict[str, Any]:
    outcome, is_aimed = Outcome(row["outcome"]), bool(row["surface_point"].any())
    pose, settled = (_pose(row[name], scene.gripper) for name in ("base_to_object", "settled"))
    label = int(GenomeReader.of(scene, prior).labels(row["genome"][None])[0])
    moved, turned = object_motion(row.reshape(1))[0].tolist()
    (margin,) = recorded_margins(row.reshape(1), scene.object).tolist()
    plain = ("generation", "index", "trial", "fitness", "descriptor", "contacts", "penetration")
    return {name: row[name].tolist() for name in plain} | {
        "outcome": outcome.name.lower(),
        "meaning": OUTCOME_MEANINGS[outcome],
        "cell": cells(row["descriptor"][:3]).tolist() if pose else None,  # of 1 cm
        "base_to_object": pose,  # as commanded, before closing
        "settled": settled,  # after closing, with `joints`
        "moved": moved if settled else None,  # by which the object did in the hand while it closed
        "turned": turned if settled else None,
        "margin": margin if settled else None,  # Ferrari-Canny
        "joints": list(_joints(row, scene.gripper)) if outcome.is_simulated else [],
        "synergy": scene.gripper.synergies[label].name if label >= 0 else "",
        "surface_point": row["surface_point"].tolist() if is_aimed else None,  # that was aimed at
        "nu": float(row["nu"]) if is_aimed else None,  # from its normal to the direction of the hand
        "contact_points": list(row_contacts(row, scene.gripper)),
        "genome": list(_gene_values(row, scene, prior)),
    }


def known(value: Any) -> float | None:
    """Return a number, an array (), as a float; None where it is NaN."""
    return None if np.isnan(value) else float(value)


def row_contacts(row: np.void, gripper: SceneGripper) -> Iterator[dict[str, Any]]:
    """Yield a row's contacts: points on the object, unit normals into it, forces along them."""
    values = row["contact_points"].astype(float).reshape(-1, CONTACT_VALUES).tolist()
    for link, (*vectors, force) in zip(row["contact_links"].tolist(), values, strict=True):
        if link:
            name = gripper.links[link - 1]
            yield {"link": name, "point": vectors[:3], "normal": vectors[3:], "force": force}


def _pose(values: NDArray[np.float32], gripper: SceneGripper) -> dict[str, Any] | None:
    """Return the pose of the hand's root link, or None without one."""
    pose = values.tolist()
    if not any(pose[3:]):
        return None
    place = {"position": pose[:3], "quaternion_xyzw": pose[3:]}
    return {"link": gripper.base_link, "frame": POSE_FRAME} | place


def _joints(row: np.void, gripper: SceneGripper) -> Iterator[dict[str, Any]]:
    robot = scene_robot(gripper)
    for joint, position in zip(gripper.joints, row["joints"].tolist(), strict=False):
        found = robot.joint(joint.name)
        slides = found is not None and found.kind == "prismatic"
        yield {"name": joint.name, "position": position, "unit": "m" if slides else "rad"}


def _gene_values(row: np.void, scene: Scene, prior: str) -> Iterator[dict[str, Any]]:
    """Yield genes in [-1, 1] with the values that they stand for; equal under `given`."""
    known = GenomeReader.of(scene, prior)
    (values,) = known.values(row["genome"][None]).tolist()
    for name, gene, value in zip(known.layout.names, row["genome"].tolist(), values, strict=False):
        yield {"name": name, "gene": gene, "value": value}


def genome_reader(folder: RunFolder) -> GenomeReader:
    """Return the reader of a run's genomes; without its scene all synergies are one."""
    return GenomeReader.of(folder.scene(), prior_of(folder.spec)) if folder.has_bundle() else UNKNOWN_GENOMES


FIRST_FIELDS = (
    *("run", "gripper", "object", "scale", "method", "aim_for"),
    *("told_apart_by", "protocol", "engine", "seed", "overlaps_mode"),
    *("evaluations", "budget", "rows", "trials"),
)
"""Figures that a table begins with."""


class RunSummary(RunListing, frozen=True, kw_only=True):
    """The figures of a run."""

    scale: float = 1.0
    """Metres to a unit of the object's mesh file."""
    aim_for: str = ""
    """Objective of a method that has one; empty: none, or `touch` in runs recorded without it."""
    told_apart_by: str = ""
    """Diversity that the search looked for, `position`, `orientation` or `contact`; empty: no objective."""
    engine: str = DEFAULT_ENGINE
    """The physics engine."""
    overlaps_mode: str
    """Mode of counting overlaps, `count` or `redraw`."""
    diversity: Diversity
    """Niches of position, orientation and synergy with a success."""
    qd_score: float
    """Best fitness in each of these cells, summed; fitness as the search gets it."""
    success_share: float | None
    """`successes` over `evaluations`, 0 to 1; None before the first evaluation."""
    mean_fitness: float | None
    """Mean fitness of all successes; None without one."""
    nu: NuSummary
    """Lean of successes from the surface normal."""
    eta: EtaSummary | None
    """Estimated probability that successes transfer; None where the protocol has no trials."""
    cpu_seconds: float
    wall_seconds: float
    complete: bool
    collision_source: str
    """Source of the object's convex parts."""
    coupling_error: float | None
    """Farthest that a coupled joint is from its place in grasps that hold [rad or m]; None: there is none."""
    platform: dict[str, str]
    in_both: dict[str, HeldShare] = field(default_factory=dict)
    """Of grasps that hold, how many do so in another engine too, by its name, where the run has a table."""
    rows_by_host: dict[str, int] = field(default_factory=dict)
    """Rows that the workers of each host made."""

    @property
    def words(self) -> str:
        """One sentence for a person."""
        evaluations = counted(self.evaluations, "evaluation")
        return (
            f"{evaluations} of {self.method} with {self.gripper} on {self.object}: "
            f"{self.found}, {counted(self.grasps, 'grasp')}, {self.robust} robust; {self.screened}."
        )

    @property
    def table(self) -> str:
        """All figures, one to a line."""
        values = dict.fromkeys(FIRST_FIELDS, "") | structs.asdict(self)
        del values["outcomes"]
        for name in ("diversity", "nu", "eta"):
            values[name] = values[name] and values[name].words
        values["in_both"] = [f"{name} {share.words}" for name, share in self.in_both.items()]
        values["rows_by_host"] = [f"{host}: {counted(n, 'row')}" for host, n in self.rows_by_host.items()]
        values["platform"] = [f"{name} {value[:24]}" for name, value in sorted(self.platform.items())]
        return report_table(values)


def run_summary(folder: RunFolder) -> RunSummary:
    """Count what is in a run's folder, also while the run goes on."""
    return read_summary(folder)[0]


def read_summary(folder: RunFolder) -> tuple[RunSummary, Successes]:
    """Count what is in a run's folder, with or without its scene, and return its successes too."""
    spec = folder.spec
    with folder.journal() as journal:
        plan, counts = TrialPlan.of(spec), RunCounter(spec)
        blocks = counts.counting(chain([journal.shape.empty(0)], journal.blocks()))
        found = join_successes([*find_successes(blocks, plan, spec.overlaps)])
        metrics, totals, hosts = SuccessMetrics(plan), counts.totals, Counter[str]()
        metrics.add(found)
        for _, n, _, host in journal.makers():
            hosts[host] += n
        scene, outcomes = folder.scene() if folder.has_bundle() else None, found.rows["outcome"]
        held = found.rows["joints"][outcomes == Outcome.HELD]
        summary = RunSummary(
            **structs.asdict(RunListing.of(journal.run, journal.scene, counts)),
            scale=spec.scale or 1.0,
            aim_for=spec.aim_for or "",
            told_apart_by=spec.diversity or ("position" if spec.aim_for else ""),
            engine=spec.engine or DEFAULT_ENGINE,
            overlaps_mode=spec.overlaps,
            diversity=diversity(niches(found.rows, genome_reader(folder)), outcomes),
            qd_score=metrics.qd_score,
            success_share=totals.successes / totals.evaluations if totals.evaluations else None,
            mean_fitness=metrics.mean_fitness,
            nu=metrics.nu,
            eta=metrics.eta,
            cpu_seconds=journal.cpu_seconds,
            wall_seconds=journal.wall_seconds,
            complete=counts.finished is not None,
            collision_source=scene.object.collision_source if scene else "",
            coupling_error=coupling_error(scene.gripper, held) if scene else None,
            platform=journal.platform,
            in_both=held_shares(folder),
            rows_by_host=dict(hosts.most_common()),
        )
    return summary, found
