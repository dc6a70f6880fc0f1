"""`qdgrasp render`, `verify`, `export`, `import` and `bench`, with the processes they start."""

import re
import signal
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.common import wait_for
from tests.coordinator.recorded_runs import record
from tests.system.commands import Commands, processes_of, stop

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


def test_a_grasp_is_drawn_the_same_every_time(qdgrasp: Commands, reference: Reference) -> None:
    run, held = reference[0], first(rows_of(reference[0]), Outcome.HELD)
    for name in ("one.png", "other.png"):
        done = qdgrasp("render", run, "--grasp", held, "-o", name, "--size", "400x360")
        assert (done.code, done.out) == (0, f"held, row {held}: drawn in {name}\n"), done.err
    one, other = ((qdgrasp.home / name).read_bytes() for name in ("one.png", "other.png"))
    assert one == other
    with Image.open(qdgrasp.home / "one.png") as image:
        assert image.size == (400, 360)
        assert len(image.getcolors(1 << 20) or []) > 500


def test_a_film_goes_through_an_evaluation(qdgrasp: Commands, reference: Reference) -> None:
    run, held = reference[0], first(rows_of(reference[0]), Outcome.HELD)
    qdgrasp.succeed("render", run, "--grasp", held, "-o", "a.gif", "--size", "320x240", "--what", "closing")
    with Image.open(qdgrasp.home / "a.gif") as film:
        assert film.n_frames > 10
        assert film.size == (320, 240)


def test_an_evaluation_that_failed_is_shown_as_well(qdgrasp: Commands, reference: Reference) -> None:
    run, overlap = reference[0], first(rows_of(reference[0]), Outcome.OVERLAP)
    assert qdgrasp("render", run, "--grasp", overlap, "-o", "a.png").code == 0
    done = qdgrasp("render", run, "--grasp", overlap, "-o", "a.gif", "--what", "shakes")
    assert done.code == 2
    assert "This evaluation has no shakes to show: its outcome is overlap." in done.err
    assert not (qdgrasp.home / "a.gif").exists()


def test_a_replay_that_differs_is_drawn_and_told(qdgrasp: Commands, untrue: Path) -> None:
    held = first(rows_of(untrue), Outcome.HELD)
    done = qdgrasp("render", untrue, "--grasp", held, "-o", "a.png")
    assert done.code == 1
    assert f"The replay differs from row {held}: fitness 6.0 instead of 1.0." in done.err
    assert "On which platform it was recorded is not known." in done.err
    assert (qdgrasp.home / "a.png").is_file()


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


@pytest.mark.parametrize(("name", "file"), [("parquet", "f.parquet"), ("isaac", "f.yaml")])
def test_scores_of_exported_grasps_are_those_of_the_run_bit_for_bit(qdgrasp, reference, name, file):
    qdgrasp.succeed("export", reference[0], "--format", name, "--min-fitness", 0, "-o", file)
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


def test_what_a_killed_export_had_begun_is_removed_by_the_next_one(qdgrasp, reference):
    begun = qdgrasp.home / ".f.csv.1.part"
    begun.mkdir()
    (begun / "new").write_text("half")
    qdgrasp.succeed("export", reference[0], "--format", "csv", "-o", "f.csv")
    assert sorted(path.name for path in qdgrasp.home.glob("*.csv*")) == ["f.csv"]
    assert not begun.exists()


BENCH = ("bench", "--object", "tennis_ball", "--seconds", "0.2")


@pytest.mark.slow
def test_bench_measures_one_worker_and_all_and_leaves_nothing(qdgrasp):
    done = qdgrasp.succeed(*BENCH, "--workers", 2, "--json")
    (scene,) = done.json["scenes"]
    assert (scene["gripper"], scene["object"], scene["protocol"]) == ("panda", "tennis_ball", "paper")
    assert [(rate["regime"], rate["workers"]) for rate in scene["rates"]] == [
        ("anywhere", 1),
        ("near grasps", 1),
        ("anywhere", 2),
        ("near grasps", 2),
    ]
    anywhere, near = scene["rates"][:2]
    assert anywhere["per_cpu_second"] > near["per_cpu_second"]
    assert anywhere["success_share"] < 0.3 < near["success_share"]
    assert scene["memory_bytes"] > 50e6
    assert scene["start_seconds"] > 0
    assert set(scene["run_seconds"]) == set(scene["scaling"]) == {"anywhere", "near grasps"}
    assert len(done.json["platform"]["probes"]) == 64
    assert [path.name for path in qdgrasp.home.iterdir()] == ["cache"]


def test_a_person_gets_a_table_and_one_worker_has_nothing_to_scale(qdgrasp):
    done = qdgrasp.succeed(*BENCH, "--workers", 1)
    assert "panda on tennis_ball" in done.out
    assert "10,000 evaluations take" in done.out
    assert "scaling" not in done.out


def test_ctrl_c_ends_it_with_all_its_workers(qdgrasp):
    process = qdgrasp.start("bench", "--object", "tennis_ball", "--workers", 2, "--seconds", 600)
    wait_for(lambda: processes_of(process.pid), "a worker")
    out, _, _ = stop(process, signal.SIGINT)
    assert out == ""


def test_a_name_that_is_not_there_is_refused_before_anything_starts(qdgrasp):
    done = qdgrasp(*BENCH, "--gripper", "pandas")
    assert done.code == 2
    assert "pandas" in done.err
    assert done.out == ""
