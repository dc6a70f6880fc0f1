"""`qdgrasp render`, `verify`, `export`, `import` and `bench`, with the processes they start."""

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.coordinator.recorded_runs import record
from tests.system.commands import Commands

from qdgrasp_coordinator.storage.journal import JournalSlice
from qdgrasp_coordinator.storage.journal_writer import JournalWriter
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import to_values
from qdgrasp_tools.export.grasp_reader import read_run

Reference = tuple[Path, str, dict]


def rows_of(run: Path) -> Rows:
    with RunFolder.open(run).journal() as journal:
        return np.concatenate(list(journal.blocks()))


def first(rows: Rows, outcome: Outcome) -> int:
    return int(np.flatnonzero(rows["outcome"] == outcome)[0])


@pytest.fixture
def untrue(reference: Reference, tmp_path: Path) -> Path:
    """A run of whose rows one has another fitness than its evaluation gave."""
    folder, rows = RunFolder.open(reference[0]), rows_of(reference[0])
    rows["fitness"][first(rows, Outcome.HELD)] = 1
    made = record(tmp_path / "untrue", folder.scene(), rows, **to_values(folder.spec))
    (made.path / "scene.bundle").write_bytes(folder.bundle().payload)
    return made.path


@pytest.mark.slow
def test_a_grasp_is_drawn_the_same_every_time(qdgrasp: Commands, reference: Reference) -> None:
    run, held = reference[0], first(rows_of(reference[0]), Outcome.HELD)
    for name in ("one.png", "other.png"):
        done = qdgrasp("render", run, "--grasp", held, "-o", name)
        assert (done.code, done.out) == (0, f"held, row {held}: drawn in {name}\n"), done.err
    one, other = ((qdgrasp.home / name).read_bytes() for name in ("one.png", "other.png"))
    assert one == other
    with Image.open(qdgrasp.home / "one.png") as image:
        assert image.size == (640, 560)
        assert len(image.getcolors(1 << 20) or []) > 500


def test_recorded_rows_are_the_same_again(qdgrasp: Commands, reference: Reference) -> None:
    told = qdgrasp.succeed("verify", reference[0], "--sample", 40, "--workers", 1, "--json").json
    assert (told["rows"], told["same"], told["different"]) == (40, 40, [])
    assert {"overlap", "held"} <= set(told["outcomes"])
    (origin,) = told["origins"]
    assert (origin["rows"], origin["differences"]) == (40, "")
    without_engines = {name: value for name, value in told["platform"].items() if "mujoco" not in name}
    assert origin["platform"] == without_engines


def test_a_row_that_is_not_what_it_was_is_named(qdgrasp: Commands, untrue: Path) -> None:
    held = first(rows_of(untrue), Outcome.HELD)
    done = qdgrasp("verify", untrue, "--all", "--workers", 2)
    n = len(rows_of(untrue))
    assert done.code == 1, done.err
    assert done.out.splitlines()[0] == f"row {held} of {untrue}, trial 0: fitness 6.0 instead of 1.0"
    assert f"{n - 1} of {n} rows the same: " in done.out
    assert f"{n} of them were made on a platform that is not recorded" in done.out


def test_what_a_worker_got_recorded_wrong_is_taken_back_and_made_again(qdgrasp, reference, tmp_path) -> None:
    folder, rows = RunFolder.open(reference[0]), rows_of(reference[0])
    n, first_lie = len(rows), len(rows) // 3
    makers = np.resize(np.repeat(["honest node1", "wrong node2"], 50), n)
    rows[first_lie + 1 :] = rows[first_lie + 1 :][::-1]  # for the search has learned from it
    lies = (makers == "wrong node2") & (np.arange(n) >= first_lie) & (np.arange(n) % 4 == first_lie % 4)
    rows["penetration"][lies] += np.float32(1e-3)
    made = RunFolder.create(tmp_path / "lied", folder.spec, folder.bundle())
    with folder.journal() as old, JournalWriter.create(made.path, old.identity) as journal:
        for start in range(0, n, 50):
            by = tuple(makers[start : start + 50].tolist())
            journal.append(JournalSlice(start, rows[start : start + 50], makers=by), 1, 0.0, old.platform)
    done = qdgrasp("verify", made.path, "--sample", 100, "--fix", "--workers", 1)
    assert done.code == 1
    left = int(np.flatnonzero(lies)[0]) // 50 * 50
    assert f"{n - left} rows of {made.path} are taken back" in done.out
    assert qdgrasp("resume", made.path, "--workers", 1).code == 0
    assert qdgrasp.digest(made.path) == reference[1]


@pytest.mark.slow
def test_scores_of_exported_grasps_are_those_of_the_run_bit_for_bit(qdgrasp, reference):
    file = "f.yaml"
    qdgrasp.succeed("export", reference[0], "--format", "isaac", "--min-fitness", 0, "-o", file)
    run = RunFolder.open(reference[0])
    imported = qdgrasp.succeed(
        "import", file, "--gripper", run.spec.gripper, "--object", run.spec.object, "-o", "poses.npz"
    )
    (command,) = re.findall(r"^  qdgrasp (evaluate .*)$", imported.out, re.MULTILINE)
    qdgrasp.succeed(*command.split(), "--workers", 1)
    rows = read_run(run).rows
    with np.load(qdgrasp.home / "poses-scores.npz") as scores:
        assert len(rows) > 20
        assert scores["outcome"].tobytes() == rows["outcome"].tobytes()
        assert scores["joints"].tobytes() == rows["joints"].tobytes()
        assert scores["base_position"].tobytes() == rows["base_to_object"][:, :3].tobytes()
        assert scores["base_quaternion_xyzw"].tobytes() == rows["base_to_object"][:, 3:].tobytes()
        assert scores["penetration"].tobytes() == rows["penetration"].tobytes()
