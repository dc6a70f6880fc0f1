"""`qdgrasp render` and `qdgrasp verify`, with the processes that they start."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.coordinator.recorded_runs import record
from tests.system.commands import Commands

from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import to_values

Reference = tuple[Path, str, dict]


def rows_of(run: Path) -> Rows:
    with RunFolder.open(run).journal() as journal:
        return np.concatenate(list(journal.kept()))


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
    done = qdgrasp("render", run, "--grasp", held, "-o", "a.gif", "--size", "320x240", "--what", "closing")
    assert done.code == 0, done.err
    with Image.open(qdgrasp.home / "a.gif") as film:
        assert (film.n_frames, film.size) == (19, (320, 240))


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
    assert f"The replay differs from row {held}: fitness 2.0 instead of 1.0." in done.err
    assert "On which platform it was recorded is not known." in done.err
    assert (qdgrasp.home / "a.png").is_file()


def test_recorded_rows_are_the_same_again(qdgrasp: Commands, reference: Reference) -> None:
    done = qdgrasp("verify", reference[0], "--sample", 40, "--workers", 1, "--json")
    assert done.code == 0, done.err
    told = done.json
    assert (told["rows"], told["same"], told["different"]) == (40, 40, [])
    assert {"overlap", "held"} <= set(told["outcomes"])
    assert told["origins"] == [{"rows": 40, "platform": told["platform"], "differences": ""}]


def test_a_row_that_is_not_what_it_was_is_named(qdgrasp: Commands, untrue: Path) -> None:
    held = first(rows_of(untrue), Outcome.HELD)
    done = qdgrasp("verify", untrue, "--all", "--workers", 2)
    n = len(rows_of(untrue))
    assert done.code == 1, done.err
    assert done.out.splitlines()[0] == f"row {held} of {untrue}, trial 0: fitness 2.0 instead of 1.0"
    assert f"{n - 1} of {n} rows the same: " in done.out
    assert f"{n} of them were made on a platform that is not recorded" in done.out
