"""Grasps of a run as arrays: read from its journal; selected by fitness, rank and spread."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import Floats, rotate, unit
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics.arrays import take_rows
from qdgrasp_coordinator.metrics.cells import opened
from qdgrasp_coordinator.metrics.grasp_quality import (
    contact_values,
    object_motion,
    recorded_margins,
    settled_mask,
    settled_poses,
)
from qdgrasp_coordinator.metrics.run_stats import outcome_words
from qdgrasp_coordinator.metrics.successes import eta_error
from qdgrasp_coordinator.search.fixed_poses import as_given
from qdgrasp_coordinator.search.registry import prior_of
from qdgrasp_coordinator.storage.engine_table import Verdicts
from qdgrasp_protocol.errors import InputError, UnknownName, check_packages
from qdgrasp_protocol.rows import LIFT, NO_SYNERGY, Outcome, Rows
from qdgrasp_protocol.spec import ENGINES, RunSpec, engine_names
from qdgrasp_protocol.text import counted
from qdgrasp_tools.export import grip
from qdgrasp_tools.export.grasp_table import (
    COM,
    CONTACTS_MEANING,
    LIFT_MEANING,
    MESH,
    POSE_COLUMN,
    POSE_MEANING,
    Frame,
    GraspColumn,
    GraspContacts,
    arrow_table,
    change_frame,
    common_values,
    frame_of,
    region_columns,
    to_matrices,
    xyz_columns,
)

if TYPE_CHECKING:  # scipy takes its time
    from trimesh import Scene as TrimeshScene

    from qdgrasp_assets.grippers.reachability import Reach, ReachabilityCheck

GraspIndices = NDArray[np.integer] | NDArray[np.bool_] | slice
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
OUTCOMES = np.array([outcome.name.lower() for outcome in Outcome])


class Grasp(NamedTuple):
    """One grasp: two poses of the hand's root link in the frame of the object's mesh file.

    The commanded pose goes with the joints `pregrasp`, the settled pose with the joints `joints`.
    """

    number: int
    """Number of its row in the journal, from 0, as in `qdgrasp show DIR --grasp NUMBER`."""
    position: Floats
    """(3,) x y z [m] of the commanded pose, before closing."""
    quaternion_xyzw: Floats
    """(4,), unit to the accuracy of float32."""
    pregrasp: NDArray[np.float32]
    """(j,) finger joints that the hand starts from [rad or m], in the gripper's order."""
    settled_position: Floats
    """(3,) x y z [m] of the settled pose, after closing; the commanded one where it was not recorded."""
    settled_quaternion_xyzw: Floats
    """(4,), unit to the accuracy of float32."""
    joints: NDArray[np.float32]
    """(j,) finger joints at the grasp."""
    synergy: str
    """The synergy that closes the hand; empty: all driven joints."""
    outcome: Outcome
    fitness: float
    """Disturbances survived in the nominal evaluation."""
    eta: float
    """The estimated probability of transfer; NaN where it is not known."""
    eta_error: float
    """Its standard error, for the number of trials alone."""
    trials: int
    """Number of trials behind eta."""
    confidence: float
    """Confidence, 0 to 1."""
    grasps: "Grasps"
    """The set of grasps that it belongs to."""
    place: int
    """Its place in that set."""

    @property
    def arrays(self) -> "Grasps":
        """The same grasp as arrays of one line, with everything else that is known of it."""
        return self.grasps[np.array([self.place])]

    def scene(self, frame: Frame = MESH, *, closed: bool = True) -> "TrimeshScene":
        """Return hand and object as a scene of trimesh, in metres.

        Parameters
        ----------
        frame
            The world of the scene: "mesh", the frame of the object's mesh file, or "com", the same axes at
            its centre of mass.
        closed
            True: the hand as it settled, with `joints`; False: open in the commanded pose, with `pregrasp`.

        Returns
        -------
        scene
            Nodes `object`; `hand`, the frame of the hand's root link; and below it `hand/LINK`, the collision
            shapes of each link.

        Examples
        --------
        >>> grasp = next(iter(qdgrasp.open("runs/mug").grasps(top=1)))
        >>> grasp.scene().export("grasp.glb")
        """
        from qdgrasp_tools.rendering.views import grasp_scene  # takes its time to load

        alone = self.arrays
        poses = alone.settled_poses(frame_of(frame)) if closed else alone.poses(frame_of(frame))
        joints = (self.joints if closed else self.pregrasp).astype(np.float64)
        com = np.zeros(3) if frame == COM else alone.scene.object.com_in_mesh
        made = grasp_scene(alone.scene, poses[0], joints, com)
        made.metadata["frame"] = frame
        return made

    def _repr_html_(self) -> str:
        from qdgrasp_tools.rendering.views import grasp_card  # takes its time to load

        grasps, row = self.grasps, self.arrays.rows[0]
        figures = [
            ("outcome", outcome_words(self.outcome)),
            ("fitness", f"{self.fitness:g} of {grasps.spec.disturbances}"),
            ("finger links in contact", str(row["contacts"])),
            ("penetration", f"{1000 * row['penetration']:.2f} mm"),
        ]
        if self.trials:
            figures.append(("eta", f"{self.eta:.3f} ± {self.eta_error:.3f}, {self.trials} trials"))
        position = ", ".join(f"{value:.4f}" for value in self.settled_position)
        figures.append(("settled at, in the mesh's frame", f"{position} m"))
        title = f"Grasp {self.number} of {grasps.scene.gripper.name} on {grasps.scene.object.name}"
        return grasp_card(grasps.scene, self.arrays.rows, title, figures)


@dataclass(frozen=True, eq=False, repr=False)
class Grasps:
    """Evaluations of one scene, as arrays of n lines.

    Indexed by a number it gives one grasp, by a slice, mask or array several.
    """

    scene: Scene
    spec: RunSpec
    """Spec of the run."""
    run: str
    """Name of the run's folder."""
    numbers: NDArray[np.int64]
    """(n,): the rows' numbers in the journal."""
    rows: Rows
    """(n,): all columns of the journal; positions in the object's centre-of-mass frame."""
    eta: Floats
    """(n,): estimated probability of transfer; NaN where too few trials of a success are there."""
    trials: NDArray[np.int64]
    """(n,): numbers of trials behind eta."""
    eta_hard: Floats
    """(n,): share of disturbances survived in the harder trials; NaN where there are none."""
    elsewhere: dict[str, Verdicts] = field(default_factory=dict)
    """Outcome and fitness (n,) in other engines that the run has a table of; -1 and NaN: not known."""
    approach: "ReachabilityCheck | None" = None
    """How hands are to come to grasps, for `reach`; None: it was not asked for."""
    more: tuple[GraspColumn, ...] = ()
    """Columns that files have besides."""

    def __repr__(self) -> str:
        return f"<{counted(len(self), 'grasp')} of {self.scene.gripper.name} on {self.scene.object.name}>"

    def __len__(self) -> int:
        return len(self.rows)

    @overload
    def __getitem__(self, places: int) -> Grasp: ...

    @overload
    def __getitem__(self, places: GraspIndices) -> "Grasps": ...

    def __getitem__(self, places: int | GraspIndices) -> "Grasp | Grasps":
        if isinstance(places, int | np.integer):
            return self._grasp(places)
        return replace(
            self,
            numbers=self.numbers[places],
            rows=take_rows(self.rows, places),
            eta=self.eta[places],
            trials=self.trials[places],
            eta_hard=self.eta_hard[places],
            elsewhere={name: values[places] for name, values in self.elsewhere.items()},
            more=tuple(column._replace(values=column.values[places]) for column in self.more),
        )

    def __iter__(self) -> Iterator[Grasp]:
        return map(self._grasp, range(len(self)))

    def _grasp(self, place: int) -> Grasp:
        row, names = self.rows[place], (*self.synergy_names, "")
        pose, settled = (poses[place] for poses in self._in_mesh)
        return Grasp(
            number=int(self.numbers[place]),
            position=pose[:3],
            quaternion_xyzw=pose[3:],
            pregrasp=self.pregrasp[place],
            settled_position=settled[:3],
            settled_quaternion_xyzw=settled[3:],
            joints=row["joints"],
            synergy=names[self.synergies[place]],
            outcome=Outcome(row["outcome"]),
            fitness=float(row["fitness"]),
            eta=float(self.eta[place]),
            eta_error=float(self.eta_error[place]),
            trials=int(self.trials[place]),
            confidence=float(self.confidence[place]),
            grasps=self,
            place=int(place),
        )

    @cached_property
    def _in_mesh(self) -> tuple[Floats, Floats]:
        return self.poses(MESH), self.settled_poses(MESH)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The finger joints, in the order of `joints` and `pregrasp`."""
        return tuple(joint.name for joint in self.scene.gripper.joints)

    @cached_property
    def postures(self) -> grip.Postures:
        """Every joint of the hand, fixed ones too, as files have them."""
        return grip.whole_postures(self.scene.gripper, self.spec, self.pregrasp, self.joints, self.synergies)

    @property
    def synergy_names(self) -> tuple[str, ...]:
        """Names of the labels in `synergies`."""
        return tuple(synergy.name for synergy in self.scene.gripper.synergies)

    @property
    def joints(self) -> NDArray[np.float32]:
        """(n, j): finger joints at the grasp [rad or m]."""
        return np.asarray(self.rows["joints"])

    @property
    def fitness(self) -> NDArray[np.float32]:
        """(n,): disturbances survived in the nominal evaluation: shakes, forces or a lift."""
        return np.asarray(self.rows["fitness"])

    @property
    def is_success(self) -> NDArray[np.bool_]:
        """(n,): True if a finger touches the object after closing."""
        return np.asarray(self.rows["outcome"] >= Outcome.DROPPED)

    @property
    def is_grasp(self) -> NDArray[np.bool_]:
        """(n,): True if at least one disturbance was survived."""
        return np.asarray(self.rows["outcome"] >= Outcome.SHAKEN)

    def verdicts_in(self, engine: str) -> NDArray[np.int8]:
        """(n,): outcomes in an engine, its own or one that the run has a table of; -1: not known.

        A run of two engines knows of those that hold in both alone. Raises UnknownName and InputError.
        """
        if engine not in ENGINES:
            raise UnknownName("engine", engine, ENGINES)
        own, outcomes = engine_names(self.spec.engine), self.rows["outcome"].astype(np.int8)
        if engine in own:
            is_known = (len(own) == 1) | (outcomes == Outcome.HELD)
            return np.where(is_known, outcomes, np.int8(-1))
        if engine not in self.elsewhere:
            raise InputError(
                f"Which grasps hold in {engine} is not known of this run: run "
                f"'qdgrasp verify DIR --engine {engine} --all' first."
            )
        return np.asarray(self.elsewhere[engine]["outcome"])

    @cached_property
    def eta_error(self) -> Floats:
        """(n,): standard error of eta, for the number of trials alone; NaN where eta is not known."""
        return eta_error(self.eta, self.trials)

    @cached_property
    def confidence(self) -> Floats:
        """(n,), 0 to 1, higher is better: eta where known, else the share of disturbances survived."""
        return np.where(np.isnan(self.eta), self.fitness / self.spec.disturbances, self.eta)

    @property
    def reseated(self) -> NDArray[np.bool_]:
        """(n,): True where the commanded pose is the one at which the hand had settled before."""
        return np.isin(self.rows["index"], self.spec.reseated or ())

    @cached_property
    def starts(self) -> NDArray[np.float32]:
        """(n, d): genomes of the prior `given` that evaluate to these very rows, bit for bit."""
        return as_given(self.scene, prior_of(self.spec), self.rows)

    @cached_property
    def pregrasp(self) -> NDArray[np.float32]:
        """(n, j): finger joints that hands start from: open, free joints as the genome says."""
        return opened(self.scene.gripper, self.spreads)

    @cached_property
    def synergies(self) -> NDArray[np.int64]:
        """(n,): label of the synergy that closes each hand, or `NO_SYNERGY`: all driven joints do."""
        if not self.scene.gripper.synergies:
            return np.full(len(self), NO_SYNERGY)
        return self.starts[:, 7].astype(np.int64)

    @property
    def synergy_words(self) -> NDArray[np.str_]:
        """(n,): name of the synergy that closes each hand; empty: all driven joints do."""
        return np.array([*self.synergy_names, ""])[self.synergies]

    @property
    def spreads(self) -> NDArray[np.float32]:
        """(n, k): initial positions of the free joints [rad]."""
        count = len(self.scene.gripper.free_joints)
        return self.starts[:, self.starts.shape[1] - count :]

    def poses(self, frame: Frame = MESH) -> Floats:
        """(n, 7): the commanded poses of the hand's root link, x y z [m] and quaternion xyzw.

        They go with the joints `pregrasp`.
        `frame` "mesh" is that of the object's mesh file, in metres; "com" has the same axes at the centre of
        mass. Raises UnknownName if it is neither.
        """
        poses = self.rows["base_to_object"].astype(np.float64)
        return change_frame(poses, self.scene.object.com_in_mesh, COM, frame_of(frame))

    def settled_poses(self, frame: Frame = MESH) -> Floats:
        """(n, 7): the poses of the hand's root link after closing, before any disturbance.

        They go with the joints `joints`.
        While the hand closes the object moves, so that this pose in its frame differs from the commanded one
        (`motion`). Where it was not recorded it is the commanded one (`is_settled`). `frame` as of `poses`.
        """
        poses = settled_poses(self.rows)
        return change_frame(poses, self.scene.object.com_in_mesh, COM, frame_of(frame))

    def recorded_poses(self, frame: Frame = MESH) -> Floats:
        """(n, 7): the settled poses, NaN where none was recorded; `frame` as of `poses`."""
        return np.where(self.is_settled[:, None], self.settled_poses(frame), np.nan)

    @cached_property
    def is_settled(self) -> NDArray[np.bool_]:
        """(n,): True where the settled pose is recorded: of successes."""
        return settled_mask(self.rows)

    @cached_property
    def motion(self) -> Floats:
        """(n, 2): how far the object moved in the hand while it closed [m], and turned [rad].

        The way of its centre of mass. NaN where the settled pose is not recorded.
        """
        return object_motion(self.rows)

    @cached_property
    def reach(self) -> "Reach":
        """Answers whether hands come to their commanded poses; needs `approach`."""
        if self.approach is None:
            raise InputError("How hands come to these grasps was not asked for: give an approach_distance.")
        poses = self.rows["base_to_object"]
        return self.approach((poses[:, :3], poses[:, 3:], self.pregrasp))

    @cached_property
    def approach_directions(self) -> Floats:
        """(n, 3): unit vectors, object's frame, along which hands come to their poses."""
        turns = unit(self.rows["base_to_object"][:, 3:].astype(np.float64))
        axis = np.array(self.scene.gripper.approach_axis)
        return rotate(turns, np.broadcast_to(axis, (len(self), 3)))

    @cached_property
    def resting_poses(self) -> list[list[int]]:
        """Numbers of the resting poses in which each hand comes to it; needs `approach`."""
        reach, numbers = self.reach, list(self.approach.poses) if self.approach else []
        found = reach.is_clear[:, None] & reach.is_above
        return [[numbers[place] for place in np.flatnonzero(row)] for row in found]

    def approach_poses(self, frame: Frame = MESH) -> Floats:
        """(n, 7): the poses from which open hands come to the commanded ones; `frame` as of `poses`."""
        poses = self.poses(frame)
        if self.approach is not None:
            poses[:, :3] -= self.approach.distance * self.approach_directions
        return poses

    def contacts_in(self, frame: Frame = MESH) -> GraspContacts:
        """Contacts of the hand with the object after closing; `frame` as of `poses`."""
        links, values = np.asarray(self.rows["contact_links"]), contact_values(self.rows)
        points, normals, forces = values[..., :3], values[..., 3:6], values[..., 6]
        moved = change_frame(points.reshape(-1, 3), self.scene.object.com_in_mesh, COM, frame_of(frame))
        points = np.where(links[..., None] > 0, moved.reshape(points.shape), 0.0)
        return GraspContacts(links, points, normals, forces)

    def contact_lists(self, frame: Frame = MESH) -> list[list[dict[str, Any]] | None]:
        """Return each grasp's contacts by `CONTACT_FIELDS`; None where they were not recorded."""
        found = self.contacts_in(frame).lists(self.scene.gripper.links)
        return [each if known else None for each, known in zip(found, self.is_settled, strict=True)]

    @cached_property
    def margin(self) -> Floats:
        """(n,): Ferrari-Canny margin of the contacts; NaN where it is not known."""
        return recorded_margins(self.rows, self.scene.object)

    def matrices(self, frame: Frame = MESH) -> Floats:
        """(n, 4, 4): the commanded poses as homogeneous matrices."""
        return to_matrices(self.poses(frame))

    def to_pandas(self, frame: Frame = MESH) -> Any:
        """Return the grasps as a `pandas.DataFrame`, a line each.

        The columns are those of `qdgrasp export --format parquet` (docs/formats.md), with poses in the
        object's `frame`. Raises InputError where pandas is not installed, UnknownName for another frame.
        """
        check_packages("to_pandas()", "pandas")
        return arrow_table(self.all_columns(frame_of(frame))).to_pandas()

    def all_columns(self, frame: Frame = MESH) -> dict[str, GraspColumn]:
        """Return what grasps have in common, what was simulated, every value, and contacts."""
        contacts = np.empty(len(self), dtype=object)
        contacts[:] = self.contact_lists(frame)
        same = common_values(self.spec).items()
        every = (
            *(GraspColumn(name, np.full(len(self), value), f"{name} of the run") for name, value in same),
            GraspColumn(POSE_COLUMN, self.rows["base_to_object"], POSE_MEANING),
            *self._columns(frame),
            GraspColumn("contact_points", contacts, CONTACTS_MEANING),
            *region_columns(self.scene, self.contacts_in(), self.is_settled),
        )
        return {column.name: column for column in every}

    def columns(self, frame: Frame = MESH) -> dict[str, NDArray[Any]]:
        """Return every value of the grasps (n,) by the name of its column."""
        return {column.name: column.values for column in self._columns(frame)}

    def _columns(self, frame: Frame) -> Iterator[GraspColumn]:
        rows, poses, settled = self.rows, self.poses(frame), self.recorded_poses(frame)
        yield GraspColumn("number", self.numbers, "the row's number in the journal, from 0")
        yield GraspColumn("run", np.full(len(self), self.run), "name of the run that found it")
        yield GraspColumn("generation", rows["generation"], "of the search")
        yield GraspColumn("index", rows["index"], "in the generation")
        yield GraspColumn("outcome", OUTCOMES[rows["outcome"]], "how the evaluation ended")
        survived = "disturbances survived: 0 to 2 shakes, in `physical` 0 to 6 pushes"
        yield GraspColumn("fitness", self.fitness, LIFT_MEANING if self.scene.protocol == LIFT else survived)
        for name, verdicts in self.elsewhere.items():
            words = np.append(OUTCOMES, "")[verdicts["outcome"]]  # -1, not known, is the last
            yield GraspColumn(f"{name}_outcome", words, f"how it ended in {name}; none: not evaluated there")
            yield GraspColumn(f"{name}_fitness", verdicts["fitness"], f"disturbances survived in {name}")
        yield GraspColumn("eta", self.eta, "estimated probability of transfer; none where it is not known")
        yield GraspColumn("eta_error", self.eta_error, "its standard error, for the number of trials alone")
        yield GraspColumn("trials", self.trials, "disturbed trials that eta is of")
        yield GraspColumn("eta_hard", self.eta_hard, "survival of harder trials, for grasps of equal eta")
        yield GraspColumn("confidence", self.confidence, "0 to 1, higher is better")
        for begin, kind, of in (("", "commanded", poses), ("settled_", "settled", settled)):
            for name, values in zip(POSE, of.T, strict=True):
                length = f"hand's root link in the object's frame, {kind} pose [m]"
                yield GraspColumn(begin + name, values, length if len(name) == 1 else "its quaternion")
        yield from self.postures.columns()
        yield GraspColumn("width", grip.jaw_widths(self.scene.gripper, self.joints), grip.WIDTH_MEANING)
        yield GraspColumn("grip_force", grip.grip_forces(self.contacts_in(frame)), grip.FORCE_MEANING)
        yield GraspColumn("reseated", self.reseated.astype(np.uint8), "1: closed from where it had settled")
        way, angle = self.motion.T
        yield GraspColumn("motion_mm", 1e3 * way, "way of the object in the hand while it closed [mm]")
        yield GraspColumn("motion_deg", np.degrees(angle), "its turn meanwhile [deg]")
        yield GraspColumn("synergy", self.synergy_words, "that closes the hand; none: all driven joints")
        aims = rows["surface_point"].astype(np.float64)
        aims[~aims.any(axis=1)] = np.nan
        aims = change_frame(aims, self.scene.object.com_in_mesh, COM, frame)
        yield from xyz_columns("aim_", aims, "surface point that was aimed at, object's frame [m]")
        yield GraspColumn("nu", rows["nu"], "angle of its normal to the direction to the hand [rad]")
        yield GraspColumn("contacts", rows["contacts"], "finger links that touch after closing")
        yield GraspColumn("penetration", rows["penetration"], "deepest after closing [m]")
        yield GraspColumn("margin", self.margin, "Ferrari-Canny margin of the contacts; none: not known")
        if self.approach is not None:
            yield from self._approach_columns(frame, has_table=bool(self.approach.poses))
        yield from self.more

    def _approach_columns(self, frame: Frame, *, has_table: bool) -> Iterator[GraspColumn]:
        """Yield how hands come to the commanded poses."""
        origins = self.approach_poses(frame)[:, :3]
        yield from xyz_columns("approach_", self.approach_directions, "its direction, object's frame")
        yield from xyz_columns("approach_from_", origins, "where it comes from, object's frame [m]")
        yield GraspColumn("approach_clear", self.reach.is_clear.astype(np.uint8), "1: nothing is on its way")
        if has_table:
            words = np.array([" ".join(map(str, numbers)) for numbers in self.resting_poses], dtype=str)
            yield GraspColumn("resting_poses", words, "resting poses in which it comes above the table")
            yield GraspColumn("resting_probability", self.reach.probability, "probability of these")
