"""A scene's model in MuJoCo with its state; the one module of the worker that imports it."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_protocol.errors import AssetError
from qdgrasp_worker.engines.mujoco_model import NEIGHBOURS, OBJECT, TABLE, SceneModel
from qdgrasp_worker.world import NEAR, Touch

FREE_DOFS = 6
mujoco.set_mju_user_warning(lambda _text: None)  # counted in `Simulation.step`; else a file is written


class SimulationDiverged(RuntimeError):
    """MuJoCo met numbers that are not finite, or had no room for its contacts."""


class Simulation:
    """A model of a scene with its state; MuJoCo's own quaternions are wxyz."""

    def __init__(self, scene: SceneModel, mjcf: str, *, is_free: bool = True) -> None:
        try:
            self.model: Any = mujoco.MjModel.from_xml_string(mjcf)
        except ValueError as error:
            raise AssetError(f"MuJoCo cannot take this hand with this object: {error}") from None
        self.data: Any = mujoco.MjData(self.model)
        self._warnings = self.data.warning.number  # A view: numbers of each warning since the last reset
        joints = [self.model.joint(joint.name) for joint in scene.joints]
        self.places = np.array([joint.qposadr[0] for joint in joints])
        """(j,): places of the finger joints in `qpos`."""
        self.dofs = np.array([joint.dofadr[0] for joint in joints])
        """(j,): places of the finger joints in `qvel`."""
        self.object = int(self.model.body(OBJECT).id)
        self._is_free = is_free
        self._couplings = scene.couplings
        self.is_object = self.model.geom_bodyid == self.object
        self.of_object = np.flatnonzero(self.is_object)
        bodies = self.model.geom_bodyid
        names = np.array([self.model.body(i).name for i in bodies])
        self._is_table = names == TABLE
        is_link = ~np.isin(names, [OBJECT, NEIGHBOURS, TABLE])
        met = np.where(is_link[:, None] & self.is_object, bodies[:, None], -1)
        self.link_met = np.maximum(met, met.T)
        """(g, g): link of the hand in a contact of two geoms, the other the object's; -1: there is none."""
        around = self.model.geom_bodyid[names == NEIGHBOURS]
        self._neighbours = self.model.body_mocapid[np.unique(around)]  # none or one
        self._force = np.zeros(6)
        moving = [self.model.joint(i) for i in range(self.model.njnt)]
        self._joint_places = {joint.name: int(joint.qposadr[0]) for joint in moving if joint.name}

    def reset(self, posture: Sequence[float], friction: Sequence[float]) -> None:
        """Reset the whole state; the fingers are at `posture`.

        `friction` is that of hand and object: sliding, spinning, rolling.
        """
        mujoco.mj_resetData(self.model, self.data)
        self.model.geom_friction[self.of_object] = friction
        self.damp(0.0)
        self.data.qpos[self.places] = posture

    def damp(self, rate: Floats | float) -> None:
        """Damp the free object's velocity with these forces [N s/m, Nm s/rad]."""
        if self._is_free:
            self.model.dof_damping[-FREE_DOFS:] = rate

    def couple(self, closing: Sequence[str]) -> None:
        """Couple the joints that close together, where both close, and no others."""
        self.data.eq_active[:] = self.coupled(closing)

    def coupled(self, closing: Sequence[str]) -> list[bool]:
        """Return which of the couplings hold while these joints close."""
        return [{name, led.leader} <= {*closing} for name, led in self._couplings.items()]

    def place(self, position: Floats, quaternion: Floats) -> None:
        """Put the object at a position (3,) [m] and quaternion (4,)."""
        pose = np.array([*position, quaternion[3], *quaternion[:3]])
        if self._is_free:
            self.data.qpos[-7:] = pose
        else:
            self.data.mocap_pos[0], self.data.mocap_quat[0] = pose[:3], pose[3:]

    def place_table(self, position: Floats, quaternion: Floats) -> None:
        """Put the middle of the table at a position (3,) [m] and quaternion (4,)."""
        self.data.mocap_pos[-1], self.data.mocap_quat[-1] = position, quaternion[[3, 0, 1, 2]]

    def place_neighbours(self, position: Floats, quaternion: Floats) -> None:
        """Put the neighbours, where there are any, at a position (3,) [m] and quaternion (4,)."""
        self.data.mocap_pos[self._neighbours] = position
        self.data.mocap_quat[self._neighbours] = quaternion[[3, 0, 1, 2]]

    def is_on_table(self) -> bool:
        """Return whether the object touches the table, by the contacts of the last step."""
        contact = self.data.contact
        geoms, near = contact.geom, contact.dist - contact.includemargin < NEAR
        return bool((near & self.is_object[geoms].any(axis=1) & self._is_table[geoms].any(axis=1)).any())

    def object_pose(self) -> tuple[Floats, Floats]:
        """Position (3,) [m] and quaternion (4,) of the free object."""
        pose = self.data.qpos[-7:]
        return pose[:3].copy(), pose[[4, 5, 6, 3]]

    def detect(self) -> None:
        """Find the contacts at the present poses."""
        mujoco.mj_fwdPosition(self.model, self.data)

    def step(self, steps: int) -> None:
        """Simulate `steps` steps; a SimulationDiverged where the state is not to be trusted."""
        mujoco.mj_step(self.model, self.data, steps)
        self.check()

    def begin_step(self) -> None:
        """Simulate the first half of a step, up to its constraints, which may then be changed."""
        mujoco.mj_step1(self.model, self.data)

    def end_step(self) -> None:
        """Simulate the second half; a SimulationDiverged as in `step`."""
        mujoco.mj_step2(self.model, self.data)
        self.check()

    def check(self) -> None:
        """Raise a SimulationDiverged where the state is not to be trusted."""
        if any(warnings := self._warnings.tolist()):
            raise SimulationDiverged(f"MuJoCo warned: {warnings}")

    @property
    def buffers_used(self) -> tuple[int, int]:
        """The most contacts, and constraints, that there were at a time since the last reset."""
        return int(self.data.maxuse_con), int(self.data.maxuse_efc)

    def hand_contacts(self, nearest: float = NEAR) -> list[tuple[int, int, float]]:
        """Number, body of the hand and distance [m] of each contact with the object.

        They are nearer than `nearest`; the distance is 0 where forces begin.
        """
        if not self.data.ncon:
            return []
        contact = self.data.contact
        distance = contact.dist - contact.includemargin
        first, second = contact.geom.T
        links = self.link_met[first, second]
        chosen = np.flatnonzero((distance < nearest) & (links >= 0))
        return list(zip(chosen.tolist(), links[chosen].tolist(), distance[chosen].tolist(), strict=True))

    def force(self, contact: int) -> tuple[Floats, Floats, float]:
        """Point (3,) on the object, unit normal (3,) into it, and force along it [N]; world frame."""
        found = self.data.contact[contact]
        mujoco.mj_contactForce(self.model, self.data, contact, self._force)
        normal = found.frame[:3] * (-1.0 if self.is_object[found.geom[0]] else 1.0)
        return found.pos + normal * found.dist / 2, normal, float(self._force[0])

    def touches(self) -> list[Touch]:
        """The contacts of the hand with the object; distances are those of `hand_contacts`."""
        found = []
        for contact, link, distance in self.hand_contacts():
            point, normal, _ = self.force(contact)
            found.append(Touch(self.model.body(link).name, point.tolist(), normal.tolist(), distance))
        return found

    def joint_positions(self) -> dict[str, float]:
        """Positions of the joints of the hand that move, by name [rad or m]."""
        return {name: float(self.data.qpos[place]) for name, place in self._joint_places.items()}

    def touching_links(self) -> set[tuple[str, str]]:
        """The pairs of the hand's links between which there is a contact."""
        bodies = self.model.geom_bodyid[self.data.contact.geom].tolist()
        return {(self.model.body(one).name, self.model.body(other).name) for one, other in bodies}
