"""Runs that version 0.1.0 recorded are read, exported, verified and gone on with."""

import json
import shutil
import sqlite3
from pathlib import Path

import pytest
from tests.golden.runs import RECORDED, carry_out, command, digests_of, golden

import qdgrasp
from qdgrasp import Outcome
from qdgrasp_worker.platform import code_digest

SUCCESSES = [outcome for outcome in Outcome if outcome.is_success]


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A folder with copies of the recordings."""
    shutil.copytree(RECORDED, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.fixture
def recorded_digest() -> str:
    """The digest of the finished run."""
    return str(golden()["runs"]["finished"]["digest"])


def test_a_finished_run_is_read(home: Path, recorded_digest: str) -> None:
    run = qdgrasp.open(home / "finished")
    assert run.summary.complete
    assert (run.summary.successes, run.summary.grasps, run.summary.robust) == (29, 28, 21)
    assert len(run.grasps()) == 28
    assert (
        command(home, "digest", "finished").strip()
        == digests_of(home / "finished")["digest"]
        == recorded_digest
    )


def test_a_run_that_was_begun_has_the_first_rows(home: Path) -> None:
    begun, finished = (qdgrasp.open(home / name) for name in ("begun", "finished"))
    assert not begun.summary.complete
    assert begun.rows().tobytes() == finished.rows()[:56].tobytes()


@pytest.mark.usefixtures("same_platform")
@pytest.mark.parametrize(("name", "rows"), [("finished", 93), ("begun", 56)])
def test_every_row_is_verified_as_of_this_platform(name: str, rows: int, home: Path) -> None:
    told = json.loads(command(home, "verify", name, "--all", "--json", "--workers", 1))
    assert told["same"] == told["rows"] == rows
    assert [origin["differences"] for origin in told["origins"]] == [""]


def test_the_code_of_today_is_known_to_give_the_same_bits() -> None:
    """Its digest goes into `FIRST_RECORDED_AS` if the probes and the other tests here agree."""
    with sqlite3.connect(f"file:{RECORDED / 'begun' / 'run.sqlite'}?immutable=1", uri=True) as database:
        (told,) = database.execute("SELECT value FROM meta WHERE name = 'platform'").fetchone()
    assert json.loads(told)["code"] == code_digest()
    assert json.loads(told)["probes"] == golden()["probes"]


@pytest.mark.usefixtures("same_platform")
@pytest.mark.parametrize("version", ["0.1.0", "0.0.9"])
def test_a_run_that_was_begun_by_any_version_is_gone_on_with(version, home, recorded_digest) -> None:
    with sqlite3.connect(home / "begun" / "run.sqlite") as database:
        change = "UPDATE meta SET value = replace(value, '0.1.0', ?) WHERE name = 'platform'"
        database.execute(change, (version,))
    carry_out(home, "resume", "begun")
    assert digests_of(home / "begun")["digest"] == recorded_digest
    assert qdgrasp.open(home / "begun").summary.platform["qdgrasp"] == version
