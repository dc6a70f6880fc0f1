"""Worlds of `physical` on a device of warp; the one module that imports it.

MuJoCo Warp computes in float32. On warp's CPU device a world's numbers do not depend on the worlds beside it;
on a GPU they differ from one evaluation to the next, as the order of constraints is not fixed there. Buffers
have the size measured for a scene; a row whose world overflows them is evaluated again in MuJoCo
(`LockstepEvaluator`).
"""

from dataclasses import replace
from functools import partial
from importlib.metadata import version
from typing import Any

import mujoco_warp
import numpy as np
import warp
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.spec import DEVICE_ENGINE, Device
from qdgrasp_worker.engines.lockstep import (
    MOVING,
    BufferSizes,
    LockstepEvaluator,
    States,
    StepResult,
    WorldContacts,
    next_power,
)
from qdgrasp_worker.engines.mujoco_simulation import FREE_DOFS, Simulation
from qdgrasp_worker.world import NEAR

OVERFLOWS = (
    mujoco_warp.OverflowType.NEFC
    | mujoco_warp.OverflowType.NJMAX_NNZ
    | mujoco_warp.OverflowType.BROADPHASE
    | mujoco_warp.OverflowType.NARROWPHASE
    | mujoco_warp.OverflowType.CCD
    | mujoco_warp.OverflowType.EPA_HORIZON
)
warp.config.log_level = warp.LOG_WARNING


class WorldBatch:
    """Some worlds of a model on a device, with the steps between two looks as a graph."""

    def __init__(self, simulation: Simulation, model: Any, size: int, buffers: BufferSizes) -> None:
        self.data = mujoco_warp.make_data(
            simulation.model, nworld=size, nconmax=buffers.contacts, njmax=buffers.constraints
        )
        self._friction = np.tile(simulation.model.geom_friction.astype(np.float32), (size, 1, 1))
        self._damping = np.tile(simulation.model.dof_damping.astype(np.float32), (size, 1))
        self._forces = np.zeros((size, simulation.model.nbody, 6), dtype=np.float32)
        self._simulation, self._size = simulation, size
        self.model = replace(
            model,
            geom_friction=warp.array(self._friction, dtype=warp.vec3),
            dof_damping=warp.array(self._damping, dtype=float),
        )
        self._graphs: dict[int, Any] = {}
        self._step(1)  # loads the kernels, which cannot be done while a graph is captured

    def write(self, states: States) -> None:
        """Set the states of the first n worlds, and those of the last one for all others."""
        n = len(states["qpos"])
        padded = {name: values[np.arange(self._size).clip(max=n - 1)] for name, values in states.items()}
        self._friction[:, self._simulation.of_object] = padded.pop("friction")[:, None]
        self._forces[:, self._simulation.object, :3] = padded.pop("force")
        damping = padded.pop("damping")
        if damping.size:
            self._damping[:, -FREE_DOFS:] = damping
        self.model.geom_friction.assign(self._friction)
        self.model.dof_damping.assign(self._damping)
        self.data.xfrc_applied.assign(self._forces)
        for name, values in padded.items():
            if values.size:
                as_there = values if values.dtype == bool else values.astype(np.float32)
                getattr(self.data, name).assign(as_there)
        self.data.overflow.zero_()

    def move(self, steps: int) -> None:
        """Simulate `steps` steps."""
        if not warp.get_device().is_cuda:
            self._step(steps)
        else:
            if steps not in self._graphs:
                with warp.ScopedCapture() as capture:
                    self._step(steps)
                self._graphs[steps] = capture.graph
            warp.capture_launch(self._graphs[steps])

    def _step(self, steps: int) -> None:
        for _ in range(steps):
            mujoco_warp.step(self.model, self.data)

    def read(self, n: int) -> StepResult:
        """The present state of the first n worlds."""
        data, object_ = self.data, self._simulation.object
        states: States = {name: host(getattr(data, name)[:n]) for name in MOVING}
        failed = (data.overflow[:n].numpy() & int(OVERFLOWS)) != 0
        found, near = int(data.nacon.numpy()[0]), int(data.ncollision.numpy()[0])
        failed |= max(found, near) > data.naconmax
        for values in states.values():
            failed |= ~np.isfinite(values).all(axis=1)
        place, turn = host(data.xpos)[:n, object_], host(data.xquat)[:n, object_][:, [1, 2, 3, 0]]
        return StepResult(states, self._contacts(min(found, data.naconmax), n), (place, turn), failed)

    def _contacts(self, found: int, n: int) -> WorldContacts:
        """The contacts of the first n worlds with the object, among all that were found."""
        contact, simulation = self.data.contact, self._simulation
        geoms, worlds = contact.geom[:found].numpy(), contact.worldid[:found].numpy()
        distances = host(contact.dist[:found]) - host(contact.includemargin[:found])
        links = simulation.link_met[geoms[:, 0], geoms[:, 1]]
        chosen = np.flatnonzero((distances < NEAR) & (links >= 0) & (worlds < n))
        chosen = chosen[np.argsort(worlds[chosen], kind="stable")]
        is_first = simulation.is_object[geoms[chosen, 0]]
        normals = host(contact.frame[:found])[chosen, 0] * np.where(is_first, -1.0, 1.0)[:, None]
        depths = host(contact.dist[:found])[chosen]
        return WorldContacts(
            worlds[chosen].astype(np.intp),
            links[chosen].astype(np.intp),
            distances[chosen],
            host(contact.pos[:found])[chosen] + normals * depths[:, None] / 2,
            normals,
            self._contact_forces(chosen),
        )

    def _contact_forces(self, chosen: NDArray[np.intp]) -> Floats:
        """The forces (c,) of contacts along their normals [N]."""
        if not len(chosen):
            return np.zeros(0)
        forces = warp.zeros(len(chosen), dtype=warp.spatial_vector)
        which: Any = warp.array(chosen.astype(np.int32), dtype=int)
        mujoco_warp.contact_force(self.model, self.data, which, False, forces)
        return host(forces)[:, 0]


class WarpWorlds:
    """Any number of worlds of a model on a device of warp; a MemoryError if they do not fit."""

    def __init__(self, simulation: Simulation, buffers: BufferSizes, device: Device) -> None:
        self._simulation, self._buffers, self._device = simulation, buffers, device
        with warp.ScopedDevice(device.name):
            self._model = mujoco_warp.put_model(simulation.model)
            if not warp.get_device().is_cuda:  # on a GPU it takes gigabytes, and does not fix the bits
                self._model.opt.deterministic = int(mujoco_warp.DeterminismType.ALL)
        self._model.opt.warn_overflow = 0
        self._sized: dict[int, WorldBatch] = {}

    def __call__(self, states: States, steps: int) -> StepResult:
        """Step n worlds `steps` times."""
        n = len(states["qpos"])
        size = next_power(n)
        try:
            with warp.ScopedDevice(self._device.name):
                if size not in self._sized:
                    self._sized[size] = WorldBatch(self._simulation, self._model, size, self._buffers)
                worlds = self._sized[size]
                worlds.write(states)
                worlds.move(steps)
                return worlds.read(n)
        except RuntimeError as error:
            if "Failed to allocate" not in str(error) and "out of memory" not in str(error):
                raise
            name, most = self._device
            fewer = f"start `qdgrasp-worker` with fewer, --worlds {max(1, most // 2)}"
            raise MemoryError(f"{name} has no room for {most} worlds of this scene: {fewer}.") from None


def host(values: Any) -> Floats:
    """Numbers of a device's array, as float64."""
    return np.asarray(values.numpy(), dtype=np.float64)


class WarpEvaluator(LockstepEvaluator):
    """Evaluates batches of a scene on a device of warp, at most `at_once` rows together."""

    weight = 4  # Worlds of each size have buffers of their own, on the device

    def __init__(self, scene: Scene, device: Device, *, shortcuts: bool = True) -> None:
        super().__init__(scene, partial(WarpWorlds, device=device), shortcuts=shortcuts)
        self.at_once = device.worlds


def device_entries(device: Device) -> dict[str, str]:
    """Versions of the packages, and the device; an InputError if warp has no such device."""
    try:
        found = warp.get_device(device.name)
    except (RuntimeError, ValueError) as error:
        known = ", ".join(each.alias for each in warp.get_devices())
        raise InputError(f"Warp has no device '{device.name}' here, it has {known}: {error}") from None
    return {
        DEVICE_ENGINE: version("mujoco-warp"),
        "warp": version("warp-lang"),
        "warp_device": f"{found.name} {found.arch}" if found.is_cuda else "CPU",
    }
