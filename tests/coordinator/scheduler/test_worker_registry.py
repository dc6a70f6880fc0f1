"""The workers of a job: indexes agree with a pass over all workers; platforms agree."""

import copy
import random

import pytest
from tests.fakes.messages import join_message

from qdgrasp_coordinator.scheduler.worker_registry import LOOK_SECONDS, WorkerRegistry
from qdgrasp_coordinator.storage.platforms import admit_platform, platform_differences, platform_of
from qdgrasp_protocol.errors import Refused

SCENE = "0" * 64
WORKERS = [f"{number:032x}" for number in range(6)]
CREDIT = 2


class Turmoil:
    """Random events of a registry, as scheduler and dispatcher pass them on."""

    def __init__(self, seed: int) -> None:
        self.workers = WorkerRegistry()
        self.now = 0.0
        self._chance = random.Random(seed)  # noqa: S311
        self._batches = 0
        self._link_is_up = True

    def happen(self) -> None:
        wid = self._chance.choice(WORKERS)
        self._chance.choice(
            [
                self._join,
                self._lease,
                self._lease,
                self._lease,
                self._release,
                self._release,
                lambda _: self._pass(),
                lambda wid: self.workers.progressed(wid, self.now),
                lambda wid: self.workers.answered(wid, bytes(16), self.now),
                lambda wid: self.workers.on_token(wid, False, self.now),
                self._join,
                lambda wid: self.workers.on_token(wid, True, self.now),
                lambda _: self._link(),
                lambda wid: self.workers.drain(wid) if self._chance.random() < 0.02 else None,
                lambda _: self.workers.lease_timeout.measure(self._chance.choice([0.1, 2.0, 5.0])),
            ]
        )(wid)

    def _join(self, wid: str) -> None:
        worker = self.workers.get(wid)
        self.workers.join(join_message(wid, worker.join.number + 1 if worker else 1, CREDIT), self.now)

    def _lease(self, _: str) -> None:
        worker = next(self.workers.idle(), None)
        if worker is not None:
            self._batches += 1
            self.workers.hold(worker, self._batches.to_bytes(16), SCENE, self.now)

    def _release(self, wid: str) -> None:
        worker = self.workers.get(wid)
        for batch in list(worker.batches)[:1] if worker else ():
            self.workers.release(wid, batch)

    def _pass(self) -> None:
        self.now += self._chance.choice([0.1, 1.0, 7.0, 300.0])

    def _link(self) -> None:
        self._link_is_up = not self._link_is_up
        self.workers.on_link(self._link_is_up, self.now)

    # By a pass over all workers.

    @property
    def late(self) -> set[str]:
        timeout = self.workers.lease_timeout
        return {
            worker.wid for worker in self.workers if self._link_is_up and self.now >= worker.deadline(timeout)
        }

    @property
    def free(self) -> set[str]:
        well = any(worker.is_well for worker in self.workers)
        return {worker.wid for worker in self.workers if worker.has_credit and (worker.is_well or not well)}


def leased(workers: WorkerRegistry) -> set[str]:
    """Workers that would be leased batches if there were work enough."""
    workers = copy.deepcopy(workers)
    found = set()
    for number, worker in enumerate(workers.idle()):
        workers.hold(worker, b"%16d" % number, SCENE, 0.0)
        found.add(worker.wid)
    return found


@pytest.mark.parametrize("seed", range(30))
def test_the_indexes_agree_with_a_pass_over_all_workers(seed: int) -> None:
    turmoil = Turmoil(seed)
    workers = turmoil.workers
    for _ in range(300):
        turmoil.happen()
        assert len(workers) == sum(worker.is_well for worker in workers)
        assert leased(workers) == turmoil.free
        turmoil.now += LOOK_SECONDS
        assert turmoil.late == {lost.worker.wid for lost in workers.overdue(turmoil.now)}


JOB_PLATFORM = {"qdgrasp": "0.1.0", "numpy": "2.4.6", "code": "ab" * 32}


def test_the_version_of_the_package_is_kept_and_not_compared() -> None:
    later = JOB_PLATFORM | {"qdgrasp": "0.2.0"}
    assert admit_platform(JOB_PLATFORM, later) == JOB_PLATFORM
    assert platform_differences(JOB_PLATFORM, later) == ""


@pytest.mark.parametrize("other", [{"numpy": "2.5.0"}, {"code": "cd" * 32}, {"machine": "aarch64"}])
def test_all_else_is_compared_and_then_the_version_is_told_too(other: dict[str, str]) -> None:
    (name,) = other
    with pytest.raises(Refused, match=f"{name} .* instead of .*, qdgrasp 0.2.0 instead of 0.1.0"):
        admit_platform(JOB_PLATFORM, JOB_PLATFORM | other | {"qdgrasp": "0.2.0"})


IN_MUJOCO = {"mujoco": "4.0.1", "mujoco_probes": "01" * 32}
IN_BULLET = {"pybullet": "3.2.7", "probes": "23" * 32}
OF_ALL = {name: value for name, value in JOB_PLATFORM.items() if name not in IN_BULLET}


def test_what_concerns_an_engine_is_recorded_with_its_rows_alone() -> None:
    both = OF_ALL | IN_BULLET | IN_MUJOCO
    assert platform_of(None, both) == OF_ALL | IN_BULLET
    assert platform_of("mujoco", both) == OF_ALL | IN_MUJOCO
    assert platform_of("bullet,mujoco", both) == platform_of("mujoco,bullet", both) == both


def test_rows_of_a_device_name_it_and_are_not_mixed_with_those_of_another() -> None:
    here = IN_MUJOCO | {"mujoco-warp": "4.0.0", "warp": "1.19.0", "warp_device": "NVIDIA H100 90"}
    assert platform_of("mujoco-warp", JOB_PLATFORM | here) == JOB_PLATFORM | here
    assert platform_of("mujoco", JOB_PLATFORM | here) == JOB_PLATFORM | IN_MUJOCO
    assert admit_platform(JOB_PLATFORM | here, JOB_PLATFORM | IN_MUJOCO) == JOB_PLATFORM | here
    with pytest.raises(Refused, match="warp_device NVIDIA A100 80 instead of NVIDIA H100 90"):
        admit_platform(JOB_PLATFORM | here, JOB_PLATFORM | here | {"warp_device": "NVIDIA A100 80"})
