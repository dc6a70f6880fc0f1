"""Many runs from one file: each is the run it would be alone, also after kills."""

import subprocess
from pathlib import Path

import pytest
import trimesh
from tests.system.commands import Commands, digest_of, end_of, has_rows, kill, pids

from qdgrasp_coordinator.storage.job_folder import JobFolder

SMALL = """
[defaults]
gripper = "panda"
evaluations = 40
population = 20
[[cross]]
object = "tennis_ball"
method = ["contact_rand", "contact_me_scs"]
[[cross]]
object = "rubiks_cube"
evaluations = 80
"""
RUNS = {
    "panda-tennis_ball-contact_rand-s0-population20": ("--method", "contact_rand", "--evaluations", 40),
}


def write(home: Path, text: str = SMALL) -> Path:
    path = home / "many.toml"
    path.write_text(text)
    return path


def digests(qdgrasp: Commands, folder: str = "out") -> dict[str, str]:
    """The digests of all runs of a campaign by name."""
    return {name: digest_of(path) for name, path in runs(qdgrasp, folder)}


def runs(qdgrasp: Commands, folder: str) -> list[tuple[str, Path]]:
    return [(path.name, path) for path in JobFolder.open(qdgrasp.home / folder).run_paths]


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Commands:
    """An undisturbed campaign in `out`, which tests leave as it is."""
    commands = Commands(tmp_path_factory.mktemp("campaign"))
    ended = commands.succeed("campaign", write(commands.home), "--workers", 2, "--out", "out")
    assert {"runs done        3", "evaluations      160"} <= set(ended.out.splitlines())
    return commands


@pytest.mark.parametrize("name", RUNS)
def test_each_run_of_a_campaign_is_the_run_that_it_is_alone(qdgrasp, done, name):
    scene = ("--gripper", "panda", "--object", name.split("-")[1], "--protocol", "paper")
    flags = (*scene, "--set", "population=20", *RUNS[name])
    qdgrasp.succeed("run", *flags, "--workers", 1, "--out", "alone")
    assert digest_of(qdgrasp.home / "alone") == digests(done)[name]


def test_a_finished_campaign_is_not_carried_out_again(done):
    before = digests(done)
    ended = done.succeed("campaign", "out")
    assert "3 of 3 runs are finished already" in ended.err
    assert "listening" not in ended.err
    assert digests(done) == before


@pytest.mark.slow
def test_a_folder_of_meshes_is_a_campaign(qdgrasp):
    parts = qdgrasp.home / "my parts"
    parts.mkdir()
    trimesh.creation.box(extents=(50, 60, 70)).export(parts / "large one.stl")
    asked = ("campaign", "--gripper", "panda", "--objects", parts, "--units", "mm", "--evaluations", 20)
    qdgrasp.succeed(*asked, "--mass", 0.3, "--workers", 1, "--out", "out")
    found = qdgrasp.info("out/runs/panda-large-one-portfolio-s0-physical")
    assert (found["complete"], found["scale"], found["protocol"]) == (True, 0.001, "physical")
    assert "runs done        1" in qdgrasp("campaign", "out").out


# A process is killed.


def start(qdgrasp: Commands, rows: int) -> subprocess.Popen[str]:
    """A campaign of which some rows are on disk already."""
    command = ("campaign", write(qdgrasp.home), "--workers", 2, "--out", "out")
    process = qdgrasp.start(*command)
    has_rows(process, qdgrasp.home / "out", rows)
    return process


@pytest.mark.slow
def test_a_killed_coordinator_is_started_again_and_the_campaign_ends_as_undisturbed(qdgrasp, done):
    process = start(qdgrasp, 60)
    kill(pids(process, "coordinator")[0])
    _, err = end_of(process)
    assert "was killed by SIGKILL" in err
    assert digests(qdgrasp) == digests(done)
