"""The platform that a worker's results come from."""

import json
import subprocess
import sys

from tests.worker.genomes import evaluated, outcomes

from qdgrasp_assets.catalog import build_scene
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import RunSpec, has_bullet
from qdgrasp_worker import platform as module
from qdgrasp_worker.platform import physical_probe_digest, platform, probes


def test_the_platform_names_versions_and_digests_in_words():
    found = platform()
    assert {"qdgrasp", "numpy", "evaluation", "mujoco"} <= found.keys()
    assert has_bullet() is ({"pybullet", "probes"} <= found.keys())
    assert all(isinstance(value, str) and value for value in found.values())
    assert len(found["mujoco_probes"]) == 64


WITHOUT_BULLET = """
import json, sys
sys.modules["pybullet"] = None
from qdgrasp_worker.platform import platform
print(json.dumps(platform()))
"""


def test_without_an_engine_the_platform_is_the_same_without_its_entries(monkeypatch):
    done = subprocess.run([sys.executable, "-c", WITHOUT_BULLET], capture_output=True, check=True, text=True)
    whole = platform()
    left = {name: value for name, value in whole.items() if name not in ("pybullet", "probes")}
    assert json.loads(done.stdout) == left
    for engine, entries in ("mujoco", left), ("bullet", whole.keys() - {"mujoco", "mujoco_probes"}):
        monkeypatch.setenv("QDGRASP_ENGINES", engine)
        assert platform() == {name: whole[name] for name in entries}


def test_the_probes_of_mujoco_end_in_every_way_and_a_moved_one_changes_their_digest(monkeypatch):
    scene = build_scene(RunSpec(gripper="panda", object="tennis_ball", protocol="physical", engine="mujoco"))
    moved = probes()
    found = outcomes(evaluated(scene, "approach", moved[module.PHYSICAL_PROBES]))
    assert {Outcome.OVERLAP, Outcome.BRUSHED, Outcome.DROPPED, Outcome.HELD} <= set(found)
    digest = physical_probe_digest("mujoco")
    moved[-1, 6] += 0.01
    monkeypatch.setattr(module, "probes", lambda: moved)
    assert physical_probe_digest("mujoco") != digest
