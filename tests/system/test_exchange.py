"""Grasps that leave in a file, come back from it, and are scored again."""

import re

import numpy as np
import pytest

from qdgrasp_coordinator.exchange.taking import read_grasps
from qdgrasp_coordinator.folders.folder import RunFolder


@pytest.mark.parametrize(("name", "file"), [("parquet", "f.parquet"), ("isaac", "f.yaml")])
def test_scores_of_exported_grasps_are_those_of_the_run_bit_for_bit(qdgrasp, reference, name, file):
    exported = qdgrasp("export", reference[0], "--format", name, "--min-fitness", 0, "-o", file)
    assert exported.code == 0, exported.err
    run = RunFolder.open(reference[0])
    imported = qdgrasp(
        "import", file, "--gripper", run.spec.gripper, "--object", run.spec.object, "-o", "poses.npz"
    )
    assert imported.code == 0, imported.err
    (command,) = re.findall(r"^  qdgrasp (evaluate .*)$", imported.out, re.MULTILINE)
    scored = qdgrasp(*command.split(), "--workers", 1)
    assert scored.code == 0, scored.err
    rows = read_grasps(run).rows
    with np.load(qdgrasp.home / "poses-scores.npz") as scores:
        assert len(rows) > 20
        assert scores["outcome"].tobytes() == rows["outcome"].tobytes()
        assert scores["joints"].tobytes() == rows["joints"].tobytes()
        assert scores["base_position"].tobytes() == rows["base_to_object"][:, :3].tobytes()
        assert scores["base_quaternion_xyzw"].tobytes() == rows["base_to_object"][:, 3:].tobytes()
        assert scores["penetration"].tobytes() == rows["penetration"].tobytes()


def test_what_a_killed_export_had_begun_is_removed_by_the_next_one(qdgrasp, reference):
    begun = qdgrasp.home / ".f.csv.1.part"
    begun.mkdir()
    (begun / "new").write_text("half")
    done = qdgrasp("export", reference[0], "--format", "csv", "-o", "f.csv")
    assert done.code == 0, done.err
    assert sorted(path.name for path in qdgrasp.home.glob("*.csv*")) == ["f.csv"]
    assert not begun.exists()
