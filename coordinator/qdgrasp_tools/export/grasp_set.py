"""Grasps of a run as arrays: read from its journal; selected by fitness, rank and spread."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import Floats, rotate, unit
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics.arrays import join_rows, take_rows
from qdgrasp_coordinator.metrics.grasp_quality import (
    NO_LIMITS,
    GraspLimits,
    contact_values,
    object_motion,
    recorded_margins,
    settled_mask,
    settled_poses,
    taken_mask,
)
from qdgrasp_coordinator.metrics.scores import best_first
from qdgrasp_coordinator.metrics.trial_schedule import eta_bounds, eta_error
from qdgrasp_coordinator.search.fixed_poses import as_given, opened
from qdgrasp_coordinator.search.registry import prior_of
from qdgrasp_coordinator.storage.engine_table import Verdicts
from qdgrasp_coordinator.storage.run_folder import Provenance
from qdgrasp_protocol.engines import ENGINES, engine_names
from qdgrasp_protocol.errors import ImpossibleValue, InputError, UnknownName
from qdgrasp_protocol.rows import NO_SYNERGY, Outcome, Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.text import counted
from qdgrasp_tools.export.frames import (
    COM,
    MESH,
    Frame,
    change_frame,
    frame_of,
    squared_distances,
    to_matrices,
)

if TYPE_CHECKING:  # scipy takes its time
    from trimesh import Scene as TrimeshScene

    from qdgrasp_assets.grippers.reachability import Reach, ReachabilityCheck

GraspIndices = NDArray[np.integer] | NDArray[np.bool_] | slice


class Grasp(NamedTuple):
    """One grasp: two poses of the hand's root link in the frame of the object's mesh file.

    The commanded pose goes with the joints `pregrasp`, the settled pose with the joints `joints`. A notebook
    shows it as a picture with its key figures.
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

        Raises
        ------
        UnknownName
            There is no such frame.

        Examples
        --------
        >>> grasp = next(iter(qdgrasp.open("runs/mug").grasps(top=1)))
        >>> grasp.scene().export("grasp.glb")
        """
        from qdgrasp_tools.export.grasp_pictures import grasp_scene  # takes its time to load

        return grasp_scene(self.arrays, frame_of(frame), closed=closed)

    def _repr_html_(self) -> str:
        from qdgrasp_tools.export.grasp_pictures import grasp_card  # takes its time to load

        return grasp_card(self.arrays)


CONTACT_FIELDS = ("link", "x", "y", "z", "nx", "ny", "nz", "force")
"""Fields of one contact in files: the hand's link, point [m], normal, force [N]."""


class GraspContacts(NamedTuple):
    """Contacts of n grasps in k slots each; empty slots hold zeros.

    `Grasps.contacts` are in the object's centre-of-mass frame.
    """

    links: NDArray[np.uint8]
    """(n, k): the hand's link, counted from 1 in `SceneGripper.links`; 0: no contact in this slot."""
    points: Floats
    """(n, k, 3) [m], on the object."""
    normals: Floats
    """(n, k, 3), unit, into the object."""
    forces: Floats
    """(n, k) [N], along the normal."""


@dataclass(frozen=True, eq=False, repr=False)
class Grasps:
    """Evaluations of one scene, as arrays of n lines.

    Indexed by a number it gives one grasp, by a slice, mask or array several. A notebook shows the first few
    of them as a picture.
    """

    scene: Scene
    spec: RunSpec
    """Spec of the run's folder."""
    sources: tuple[Provenance, ...]
    """The runs that found them: one, but for a merged folder."""
    origins: NDArray[np.int64]
    """(n,): index of the source that each comes from."""
    numbers: NDArray[np.int64]
    """(n,): the rows' numbers in the journal."""
    rows: Rows
    """(n,): all columns of the journal; positions in the object's centre-of-mass frame."""
    eta: Floats
    """(n,): estimated probability of transfer; NaN where too few trials of a success are there."""
    trials: NDArray[np.int64]
    """(n,): numbers of trials behind eta."""
    elsewhere: dict[str, Verdicts] = field(default_factory=dict)
    """Outcome and fitness (n,) in other engines that the run has a table of; -1 and NaN: not known."""
    approach: "ReachabilityCheck | None" = None
    """How hands are to come to grasps, for `reach`; None: it was not asked for."""

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
            origins=self.origins[places],
            numbers=self.numbers[places],
            rows=take_rows(self.rows, places),
            eta=self.eta[places],
            trials=self.trials[places],
            elsewhere={name: values[places] for name, values in self.elsewhere.items()},
        )

    def __iter__(self) -> Iterator[Grasp]:
        return map(self._grasp, range(len(self)))

    def _grasp(self, place: int) -> Grasp:
        row, names = self.rows[place], (*self.synergy_names, "")
        return Grasp(
            number=int(self.numbers[place]),
            position=self._in_mesh[place, :3],
            quaternion_xyzw=self._in_mesh[place, 3:],
            pregrasp=self.pregrasp[place],
            settled_position=self._settled_in_mesh[place, :3],
            settled_quaternion_xyzw=self._settled_in_mesh[place, 3:],
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
    def _in_mesh(self) -> Floats:
        return self.poses(MESH)

    @cached_property
    def _settled_in_mesh(self) -> Floats:
        return self.settled_poses(MESH)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The finger joints, in the order of `joints` and `pregrasp`."""
        return tuple(joint.name for joint in self.scene.gripper.joints)

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
            mend = f"run 'qdgrasp verify DIR --engine {engine} --all' first"
            raise InputError(f"Which grasps hold in {engine} is not known of this run: {mend}.")
        return np.asarray(self.elsewhere[engine]["outcome"])

    @cached_property
    def eta_error(self) -> Floats:
        """(n,): standard error of eta, for the number of trials alone; NaN where eta is not known."""
        return eta_error(self.eta, self.trials)

    @cached_property
    def confidence(self) -> Floats:
        """(n,), 0 to 1, higher is better: eta where known, else the share of disturbances survived."""
        return np.where(np.isnan(self.eta), self.fitness / self.spec.disturbances, self.eta)

    @cached_property
    def starts(self) -> NDArray[np.float32]:
        """(n, d): genomes of the prior `given` that evaluate to these very rows, bit for bit."""
        columns = 7 + bool(self.synergy_names) + len(self.scene.gripper.free_joints)
        starts = np.zeros((len(self), columns), np.float32)
        for origin, source in enumerate(self.sources):
            here = self.origins == origin
            starts[here] = as_given(self.scene, prior_of(source.spec), self.rows[here])
        return starts

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

    @cached_property
    def is_settled(self) -> NDArray[np.bool_]:
        """(n,): True where the settled pose is recorded: of successes, later than 0.1.0."""
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
        return self.approach(poses[:, :3], poses[:, 3:], self.pregrasp)

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

    @cached_property
    def contacts(self) -> "GraspContacts":
        """Contacts of the hand with the object after closing."""
        values = contact_values(self.rows)
        return GraspContacts(
            np.asarray(self.rows["contact_links"]), values[..., :3], values[..., 3:6], values[..., 6]
        )

    def contacts_in(self, frame: Frame = MESH) -> "GraspContacts":
        """The same contacts with points in a frame of the object, as of `poses`."""
        links, points, normals, forces = self.contacts
        moved = change_frame(points.reshape(-1, 3), self.scene.object.com_in_mesh, COM, frame_of(frame))
        points = np.where(links[..., None] > 0, moved.reshape(points.shape), 0.0)
        return GraspContacts(links, points, normals, forces)

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
        from qdgrasp_tools.export.tabular import data_frame, grasp_table  # pyarrow takes its time

        return data_frame(grasp_table(self, frame_of(frame), {}))

    def _repr_html_(self) -> str:
        from qdgrasp_tools.export.grasp_pictures import grasps_card  # takes its time to load

        return grasps_card(self)


def join_grasps(parts: Sequence[Grasps]) -> Grasps:
    """Join grasps of one run, one behind the other."""
    return replace(
        parts[0],
        origins=np.concatenate([part.origins for part in parts]),
        numbers=np.concatenate([part.numbers for part in parts]),
        rows=join_rows([part.rows for part in parts]),
        eta=np.concatenate([part.eta for part in parts]),
        trials=np.concatenate([part.trials for part in parts]),
        elsewhere={
            name: np.concatenate([part.elsewhere[name] for part in parts]) for name in parts[0].elsewhere
        },
    )


def select_grasps(
    grasps: Grasps,
    min_fitness: float | None = None,
    top: int | None = None,
    diverse: int | None = None,
    limits: GraspLimits = NO_LIMITS,
    holds_in: str | None = None,
    approach: "ReachabilityCheck | None" = None,
) -> Grasps:
    """Select grasps that are good and within limits, of these the best, of these spread ones.

    `min_fitness` is the least number of disturbances survived in the nominal evaluation; 0 takes all
    successes, None is as of `taken_mask`. `top` takes so many at most, best first (`best_first`: by the
    lower bound of eta where eta is known, then by fitness and margin); `diverse` takes so many at most, each
    as far as can be from those before it (`spread_places`), the best one first. Without both, grasps are in
    journal order. `holds_in` takes those that hold in this engine, by the run's table of it, `approach` those
    whose hands come to their poses. Raises ImpossibleValue for other numbers, UnknownName for another engine,
    and InputError where there is no such table.
    """
    for name, value in (("min_fitness", min_fitness), ("top", top), ("diverse", diverse)):
        if value is not None:
            _check_number(name, value, whole=name != "min_fitness")
    chosen = grasps[grasps.is_success & taken_mask(grasps.rows, grasps.spec, min_fitness)]
    if holds_in is not None:
        chosen = chosen[chosen.verdicts_in(holds_in) == Outcome.HELD]
    chosen = chosen[limits.admitted(chosen.rows, chosen.scene)]
    if approach is not None:
        chosen = replace(chosen, approach=approach)
        chosen = chosen[chosen.reach.is_reachable]
    if top is None and diverse is None:
        return chosen
    bounds = eta_bounds(chosen.eta, np.maximum(chosen.trials, 1))[0]
    chosen = chosen[best_first(chosen.rows, chosen.scene.object, top or 1, bounds)[:top]]
    return chosen if diverse is None else chosen[spread_places(chosen, diverse)]


def _check_number(name: str, value: object, *, whole: bool) -> None:
    kinds = (int, np.integer) if whole else (int, float, np.integer, np.floating)
    if isinstance(value, bool) or not isinstance(value, kinds) or not 0 <= value < np.inf:
        raise ImpossibleValue(name, value, f"{'an integer' if whole else 'a number'} not less than 0")


def spread_places(grasps: Grasps, most: int) -> NDArray[np.int64]:
    """Choose at most `most` well-spread grasps: the first, then ever the farthest from those.

    The distance of two hands is the root of the sum of two squares: the distance of their root links, and the
    way that a point at the hand's reach from its root link moves when the one hand is turned as the other, 2
    reach sin(angle / 2). A jaw turned by 180 degrees about its approach axis is the same jaw. Of equally far
    ones the first is taken (Gonzalez 1985, "Clustering to minimize the maximum intercluster distance").
    """
    poses, hand = grasps.poses(COM), grasps.scene.gripper
    nearest = np.full(len(poses), np.inf)
    chosen: list[int] = []
    while len(chosen) < min(most, len(poses)):
        place = int(np.argmax(nearest)) if chosen else 0
        chosen.append(place)
        nearest = np.minimum(nearest, squared_distances(poses, poses[place], hand))
        nearest[place] = -1.0
    return np.array(chosen, dtype=np.int64)
