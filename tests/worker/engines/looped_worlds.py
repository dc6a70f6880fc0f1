"""Worlds that MuJoCo itself steps, one after the other, in the place of a device."""

import numpy as np

from qdgrasp_worker.engines.lockstep import MOVING, BufferSizes, States, StepResult, WorldContacts
from qdgrasp_worker.engines.mujoco_simulation import Simulation


class LoopedWorlds:
    """Moves each world on by itself.

    `failing` says, by its friction, which one overflows its buffers; `garbage`: what comes of it is then NaN.
    """

    def __init__(
        self, simulation: Simulation, buffers: BufferSizes, failing=lambda friction: False, garbage=False
    ) -> None:
        self._simulation, self._failing, self._garbage = simulation, failing, garbage

    def __call__(self, states: States, steps: int) -> StepResult:
        found = [
            self._advance({name: values[i] for name, values in states.items()}, steps)
            for i in range(len(states["qpos"]))
        ]
        contacts = [(i, *contact) for i, (_, each, _, _) in enumerate(found) for contact in each]
        worlds, links, distances, points, normals, forces = (
            zip(*contacts, strict=True) if contacts else [()] * 6
        )
        return StepResult(
            {name: np.array([moved[name] for moved, *_ in found]) for name in MOVING},
            WorldContacts(
                np.array(worlds, dtype=np.intp),
                np.array(links, dtype=np.intp),
                np.array(distances, dtype=np.float64),
                np.array(points, dtype=np.float64).reshape(-1, 3),
                np.array(normals, dtype=np.float64).reshape(-1, 3),
                np.array(forces, dtype=np.float64),
            ),
            tuple(np.array(part) for part in zip(*[pose for _, _, pose, _ in found], strict=True)),
            np.array([failed for *_, failed in found]),
        )  # fmt: skip

    def _advance(self, state, steps: int):
        simulation = self._simulation
        data, model = simulation.data, simulation.model
        simulation.reset([0.0] * len(simulation.places), state["friction"])
        if len(state["damping"]):
            simulation.damp(state["damping"])
        for name in (*MOVING, "ctrl", "eq_active", "mocap_pos", "mocap_quat"):
            getattr(data, name)[:] = state[name]
        data.xfrc_applied[simulation.object, :3] = state["force"]
        simulation.step(steps)
        contacts = [
            (link, distance, *simulation.force(number))
            for number, link, distance in simulation.hand_contacts()
        ]
        pose = data.xpos[simulation.object].copy(), data.xquat[simulation.object][[1, 2, 3, 0]]
        assert model.nv == len(state["qvel"])
        moved = {name: getattr(data, name).copy() for name in MOVING}
        if failed := self._failing(state["friction"]):
            for values in moved.values() if self._garbage else ():
                values[:] = np.nan
        return moved, contacts, pose, failed
