"""Grasps: evaluations of a run as arrays, one line of each for one grasp.

`harvest.read_grasps` takes them from a run's folder. A line is an evaluation that was simulated, most often
one that held the object.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.counts import whole
from qdgrasp_coordinator.counts.poses import as_given, opened
from qdgrasp_coordinator.counts.scores import SHAKES
from qdgrasp_coordinator.exchange.frames import COM, MESH, Frame, frame_of, moved, to_matrices
from qdgrasp_coordinator.searches.search import method
from qdgrasp_protocol.genome import NO_SYNERGY
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.phrases import counted
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec

Places = NDArray[np.integer] | NDArray[np.bool_] | slice


class Found(NamedTuple):
    """A run that found grasps."""

    run: str
    """The name of its folder."""
    spec: RunSpec


class Grasp(NamedTuple):
    """One grasp. Its pose is that of the hand's root link in the frame of the object's mesh file."""

    number: int
    """The row's in the journal, from 0: `qdgrasp show DIR --grasp NUMBER` tells the rest."""
    position: Floats
    """(3,) x y z [m]."""
    quaternion_xyzw: Floats
    """(4,), unit to the accuracy of float32."""
    joints: NDArray[np.float32]
    """(j,) finger joints at the grasp [rad or m], in the gripper's order."""
    pregrasp: NDArray[np.float32]
    """(j,) finger joints that the hand starts from."""
    synergy: str
    """The synergy that closes the hand; empty: all driven joints."""
    outcome: Outcome
    fitness: float
    """Shakes survived: 0, 1 or 2."""
    eta: float
    """The estimated probability of transfer; NaN where it is not known."""
    confidence: float
    """0 to 1."""


@dataclass(frozen=True, eq=False, repr=False)
class Grasps:
    """Evaluations of one scene, as arrays of n lines; a number takes one, a slice, mask or array several."""

    scene: Scene
    spec: RunSpec
    """Of the run's folder."""
    sources: tuple[Found, ...]
    """The runs that found them: one, but for a merged folder."""
    origins: NDArray[np.int64]
    """(n,): which of the sources each comes from."""
    numbers: NDArray[np.int64]
    """(n,): the rows' numbers in the journal."""
    rows: Rows
    """(n,): all columns of the journal; positions in the object's centre-of-mass frame."""
    eta: Floats
    """(n,): the estimated probability of transfer; NaN where not all trials of a success are there."""

    def __repr__(self) -> str:
        return f"<{counted(len(self), 'grasp')} of {self.scene.gripper.name} on {self.scene.object.name}>"

    def __len__(self) -> int:
        return len(self.rows)

    @overload
    def __getitem__(self, places: int) -> Grasp: ...

    @overload
    def __getitem__(self, places: Places) -> "Grasps": ...

    def __getitem__(self, places: int | Places) -> "Grasp | Grasps":
        if isinstance(places, int | np.integer):
            return self._grasp(places)
        return Grasps(
            self.scene,
            self.spec,
            self.sources,
            self.origins[places],
            self.numbers[places],
            whole.taken(self.rows, places),
            self.eta[places],
        )

    def __iter__(self) -> Iterator[Grasp]:
        return map(self._grasp, range(len(self)))

    def _grasp(self, place: int) -> Grasp:
        row, names = self.rows[place], (*self.synergy_names, "")
        return Grasp(
            number=int(self.numbers[place]),
            position=self._in_mesh[place, :3],
            quaternion_xyzw=self._in_mesh[place, 3:],
            joints=row["joints"],
            pregrasp=self.pregrasp[place],
            synergy=names[self.synergies[place]],
            outcome=Outcome(row["outcome"]),
            fitness=float(row["fitness"]),
            eta=float(self.eta[place]),
            confidence=float(self.confidence[place]),
        )

    @cached_property
    def _in_mesh(self) -> Floats:
        return self.poses(MESH)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The finger joints, in the order of `joints` and `pregrasp`."""
        return tuple(joint.name for joint in self.scene.gripper.joints)

    @property
    def synergy_names(self) -> tuple[str, ...]:
        """What the labels in `synergies` stand for."""
        return tuple(synergy.name for synergy in self.scene.gripper.synergies)

    @property
    def joints(self) -> NDArray[np.float32]:
        """(n, j): finger joints at the grasp [rad or m]."""
        found: NDArray[np.float32] = self.rows["joints"]
        return found

    @property
    def fitness(self) -> NDArray[np.float32]:
        """(n,): shakes survived in the nominal evaluation, 0, 1 or 2."""
        found: NDArray[np.float32] = self.rows["fitness"]
        return found

    @property
    def is_success(self) -> NDArray[np.bool_]:
        """(n,): whether a finger touches the object after closing."""
        found: NDArray[np.bool_] = self.rows["outcome"] >= Outcome.DROPPED
        return found

    @property
    def is_grasp(self) -> NDArray[np.bool_]:
        """(n,): whether at least one shake was survived."""
        found: NDArray[np.bool_] = self.rows["outcome"] >= Outcome.SHAKEN
        return found

    @cached_property
    def confidence(self) -> Floats:
        """(n,), 0 to 1, higher is better: eta where it is known, elsewhere the share of shakes survived."""
        return np.where(np.isnan(self.eta), self.fitness / SHAKES, self.eta)

    @cached_property
    def starts(self) -> NDArray[np.float32]:
        """(n, d): the genomes of the prior `given` that evaluate to these very rows again, bit for bit."""
        columns = 7 + bool(self.synergy_names) + len(self.scene.gripper.free_joints)
        starts = np.zeros((len(self), columns), np.float32)
        for origin, source in enumerate(self.sources):
            here = self.origins == origin
            starts[here] = as_given(self.scene, method(source.spec.method).prior, self.rows[here])
        return starts

    @cached_property
    def pregrasp(self) -> NDArray[np.float32]:
        """(n, j): finger joints that hands start from: open, free joints as the genome says."""
        return opened(self.scene.gripper, self.spreads)

    @cached_property
    def synergies(self) -> NDArray[np.int64]:
        """(n,): the label of the synergy that closes each hand; `NO_SYNERGY` where all driven joints do."""
        if not self.scene.gripper.synergies:
            return np.full(len(self), NO_SYNERGY)
        return self.starts[:, 7].astype(np.int64)

    @property
    def spreads(self) -> NDArray[np.float32]:
        """(n, k): what the free joints start from [rad]."""
        count = len(self.scene.gripper.free_joints)
        return self.starts[:, self.starts.shape[1] - count :]

    def poses(self, frame: Frame = MESH) -> Floats:
        """(n, 7): the hand's root link, x y z [m] and quaternion xyzw, as simulated.

        Parameters
        ----------
        frame
            "mesh": of the object's mesh file, in metres; "com": with the same axes at the centre of mass.

        Raises
        ------
        UnknownName
            There is no such frame.
        """
        poses = self.rows["base_to_object"].astype(np.float64)
        return moved(poses, self.scene.object.com_in_mesh, COM, frame_of(frame))

    def matrices(self, frame: Frame = MESH) -> Floats:
        """(n, 4, 4): the same as homogeneous matrices."""
        return to_matrices(self.poses(frame))


def joined(parts: Sequence[Grasps]) -> Grasps:
    """Grasps of one run one behind the other."""
    first = parts[0]
    return Grasps(
        first.scene,
        first.spec,
        first.sources,
        np.concatenate([part.origins for part in parts]),
        np.concatenate([part.numbers for part in parts]),
        whole.joined([part.rows for part in parts]),
        np.concatenate([part.eta for part in parts]),
    )
