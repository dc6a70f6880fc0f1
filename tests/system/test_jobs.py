"""What is seen of a job, and done to it, while it goes on."""

from tests.endpoints import own_endpoint
from tests.patience import PATIENCE
from tests.system.commands import LONG, SMALL, Commands, held, kill, pids, rows_recorded, says, wait_for
from tests.system.test_bad_input import sentence

from qdgrasp_protocol.zenoh_bus import ZenohBus


class Running:
    """A run on an endpoint of its own, of which some rows are on disk."""

    def __init__(self, qdgrasp: Commands, *flags: object) -> None:
        self.qdgrasp, self.endpoint, self.folder = qdgrasp, own_endpoint(), qdgrasp.home / "run"
        command = ("run", *LONG, "--batch-size", 10, "--workers", 2, "--out", "run", "--job", "mugs")
        self.process = qdgrasp.start(*command, "--listen", self.endpoint, *flags)
        wait_for(lambda: rows_recorded(self.folder) >= 20 or self.process.poll() is not None, "rows")
        assert self.process.poll() is None, self.process.communicate()

    def __call__(self, command: str, *arguments: str):
        return self.qdgrasp(command, *arguments, "--connect", self.endpoint)

    def at_rest(self):
        """Nobody works meanwhile, so that the job is there however long something takes."""
        workers = wait_for(lambda: two(pids(self.process, "worker")), "both workers")
        return held(*workers)

    def jobs(self) -> list[dict]:
        """What is shown of all jobs; none while there is no router."""
        done = self("jobs", "--json")
        return done.json["jobs"] if done.code == 0 else []

    def shown(self) -> dict:
        (job,) = self.jobs()
        return job

    def ends(self) -> tuple[int, str]:
        _, err = self.process.communicate(timeout=PATIENCE)
        return self.process.returncode, err


def two(found: list[int]) -> list[int]:
    return found if len(found) == 2 else []


def is_idle(job: dict) -> bool:
    """Whether both of its workers are there, and have nothing to do."""
    workers = [(worker["state"], worker["batches"]) for worker in job["workers"]]
    return workers == [("idle", 0)] * 2


def test_a_job_is_seen_paused_continued_and_ends_with_the_same_digest(qdgrasp, long_digest):
    run = Running(qdgrasp)
    with run.at_rest():
        assert "is paused" in run("pause", "mugs").out
    wait_for(lambda: is_idle(run.shown()), "idle workers")
    paused = run.shown()
    assert (paused["figures"]["state"], paused["figures"]["recorders"]) == ("paused", 1)
    assert run.shown()["figures"]["evaluations"] == paused["figures"]["evaluations"]
    assert "paused until `qdgrasp continue mugs`" in run("jobs").out
    assert "Unknown job 'bowls'. Known: mugs." in sentence(run("cancel", "bowls"))
    kill(pids(run.process, "coordinator")[0])
    wait_for(lambda: [job["meta"]["epoch"] for job in run.jobs()] == [2], "the next coordinator's turn")
    assert run.shown()["figures"]["state"] == "paused"
    assert run("continue", "mugs").out == "Job 'mugs' goes on.\n"
    code, err = run.ends()
    assert code == 0, err
    assert qdgrasp.digest("run") == long_digest


def test_a_cancelled_job_keeps_what_it_has_and_can_be_gone_on_with(qdgrasp, long_digest):
    run = Running(qdgrasp)
    with run.at_rest():
        assert "Job 'mugs' ends" in run("cancel", "mugs").out
    code, err = run.ends()
    assert code == 1
    assert "Job 'mugs' was cancelled. `qdgrasp resume run` goes on" in err
    assert rows_recorded(run.folder) >= 20
    done = qdgrasp("resume", "run", "--workers", 1)
    assert done.code == 0, done.err
    assert qdgrasp.digest("run") == long_digest


def test_a_coordinator_that_is_cancelled_ends_as_it_was_asked_to(qdgrasp):
    (qdgrasp.home / "mugs.toml").write_text('gripper = "panda"\nobject = "tennis_ball"\n')
    endpoint = own_endpoint()
    process = qdgrasp.start("mugs.toml", "--listen", endpoint, module="qdgrasp_coordinator.cli.coordinator")
    says(process, "listening")
    wait_for(lambda: qdgrasp("cancel", "mugs", "--connect", endpoint).code == 0, "somebody to cancel it")
    _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, err
    assert err.endswith("qdgrasp-coordinator: Job 'mugs' was cancelled.\n")


def test_a_run_stops_after_its_seconds_and_goes_on(qdgrasp, long_digest):
    done = qdgrasp("run", *LONG, "--workers", 1, "--out", "run", "--seconds", 1.5)
    assert done.code == 0, done.err
    assert "It is not finished; `qdgrasp resume run` goes on" in done.out
    again = qdgrasp("resume", "run", "--workers", 1)
    assert again.code == 0, again.err
    assert qdgrasp.digest("run") == long_digest


def test_a_run_ends_with_its_goal_and_is_extended_from_there(qdgrasp):
    goal = ("run", *SMALL, "--evaluations", 200, "--workers", 1)
    done = qdgrasp(*goal, "--successes", 12, "--out", "run")
    assert done.code == 0, done.err
    assert "12 successes in" in done.out
    assert "It ended early: 12 successes are found." in done.out
    assert "is finished" in qdgrasp("resume", "run").out
    assert "successes must be at least 12" in sentence(qdgrasp("resume", "run", "--successes", 11))
    again = qdgrasp("resume", "run", "--successes", 30, "--no-new-cell", 150, "--workers", 1)
    assert again.code == 0, again.err
    assert "30 successes in" in again.out
    whole = qdgrasp(*goal, "--successes", 30, "--out", "whole")
    assert whole.code == 0, whole.err
    assert qdgrasp.digest("run") == qdgrasp.digest("whole")


def test_where_nobody_is_it_is_said(qdgrasp):
    endpoint = own_endpoint()
    assert "Nothing answers at" in sentence(qdgrasp("jobs", "--connect", endpoint))
    with ZenohBus.router(endpoint):
        assert qdgrasp("jobs", "--connect", endpoint).out.startswith(f"No job is at {endpoint}")
        assert qdgrasp("jobs", "--connect", endpoint, "--json").json == {"endpoint": endpoint, "jobs": []}
        assert "No job is at" in sentence(qdgrasp("pause", "mugs", "--connect", endpoint))
    for whom in ((), ("--worker", "a", "--host", "b"), ("--worker", "Moon")):
        assert "worker" in sentence(qdgrasp("drain", "mugs", *whom, "--connect", endpoint))
