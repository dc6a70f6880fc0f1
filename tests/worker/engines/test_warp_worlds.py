"""The engine mujoco-warp on a device (`make test-gpu`): warp's CPU device, or that of `QDGRASP_DEVICE`."""

import os

import numpy as np
import pytest

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import InputError, QdgraspError
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import Device, RunSpec
from qdgrasp_worker.engines.lockstep import BufferSizes, LockstepEvaluator
from qdgrasp_worker.evaluator import Evaluator
from qdgrasp_worker.platform import PROBES, platform, probes

warp_worlds = pytest.importorskip(
    "qdgrasp_worker.engines.warp_worlds", reason="it needs qdgrasp[gpu]", exc_type=ImportError
)
pytestmark = pytest.mark.timeout(900)  # kernels are compiled in the first test
DEVICE = Device(os.environ.get("QDGRASP_DEVICE") or "cpu", 32)
NOMINAL = np.zeros(PROBES, dtype=np.uint16)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene(
        RunSpec(gripper="panda", object="tennis_ball", protocol="physical", engine="mujoco-warp")
    )


@pytest.fixture(scope="module")
def evaluator(scene):
    return warp_worlds.WarpEvaluator(scene, DEVICE)


@pytest.fixture(scope="module")
def found(evaluator):
    return evaluator.evaluate("approach", probes(), NOMINAL).rows


def test_outcomes_and_settled_poses_are_those_of_mujoco(scene, evaluator, found):
    expected = Evaluator(scene).evaluate("approach", probes(), NOMINAL).rows
    assert (found["outcome"] == expected["outcome"]).sum() >= PROBES - 1
    held = (found["outcome"] == Outcome.HELD) & (expected["outcome"] == Outcome.HELD)
    assert held.sum() >= 5
    for name, tolerance in (("settled", 2e-3), ("joints", 1e-3), ("penetration", 2e-4)):
        np.testing.assert_allclose(found[name][held], expected[name][held], atol=tolerance)
    points = [rows["contact_points"][held].astype(float).reshape(-1, 8, 7) for rows in (found, expected)]
    np.testing.assert_allclose(*(each[..., 6].sum(axis=1) for each in points), rtol=0.05)
    assert evaluator.redone == 0


@pytest.mark.skipif(DEVICE.name != "cpu", reason="on a GPU the order of constraints is not fixed")
def test_a_row_has_the_same_bits_in_any_batch(evaluator, found):
    order = np.random.default_rng(0).permutation(PROBES)[:5]
    shuffled = evaluator.evaluate("approach", probes()[order], NOMINAL[:5]).rows
    assert shuffled.tobytes() == found[order].tobytes()
    alone = evaluator.evaluate("approach", probes()[:1], NOMINAL[:1]).rows
    assert alone.tobytes() == found[:1].tobytes()


def test_rows_that_overflow_the_buffers_are_those_of_mujoco(scene):
    def small(simulation, buffers: BufferSizes):
        return warp_worlds.WarpWorlds(simulation, buffers._replace(constraints=8), DEVICE)

    expected = Evaluator(scene).evaluate("approach", probes()[:4], NOMINAL[:4]).rows
    evaluator = LockstepEvaluator(scene, small)
    found = evaluator.evaluate("approach", probes()[:4], NOMINAL[:4]).rows
    assert (expected["outcome"] == Outcome.HELD).all()
    assert evaluator.redone == 4
    assert found.tobytes() == expected.tobytes()


def test_too_little_memory_is_told_with_fewer_worlds(evaluator, monkeypatch):
    def full(worlds, steps):
        raise RuntimeError(f"Failed to allocate 385113599 bytes on device '{DEVICE.name}'")

    monkeypatch.setattr(warp_worlds.WorldBatch, "move", full)
    with pytest.raises(MemoryError, match=r"has no room for 32 worlds of this scene: .*--worlds 16"):
        evaluator.evaluate("approach", probes(), NOMINAL)


def test_the_platform_names_the_device_and_its_code():
    found = platform(DEVICE)
    assert {"mujoco-warp", "warp", "warp_device", "mujoco"} <= found.keys()
    assert (found["warp_device"] == "CPU") == (DEVICE.name == "cpu")
    assert platform().items() < found.items()


def test_a_device_that_evaluates_otherwise_is_not_used(monkeypatch):
    monkeypatch.setattr(warp_worlds, "NEAR", -1.0)  # it sees no contact
    with pytest.raises(
        QdgraspError, match=rf"On the device {DEVICE.name} only .* of 16 probes of mujoco-warp"
    ):
        platform(DEVICE)


def test_a_device_that_is_not_there_is_named_with_those_that_are():
    with pytest.raises(InputError, match="Warp has no device 'tpu' here, it has c"):
        warp_worlds.device_entries(Device("tpu", 1))
