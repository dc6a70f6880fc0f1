"""The scripts of Slurm on a cluster: jobs are signalled, run out of time, make room, are cancelled."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.common import free_port, wait_for
from tests.deploy.slurm_cluster import Cluster, obstacle, running_cluster
from tests.deploy.test_slurm import MODULES, SCRIPTS
from tests.system.commands import rows_recorded

from qdgrasp_coordinator.storage.run_folder import RunFolder, journal_digest

pytestmark = [pytest.mark.slow, pytest.mark.skipif(bool(obstacle()), reason=obstacle())]
CAMPAIGN = """
[[cross]]
gripper = "panda"
object = "tennis_ball"
method = "contact_rand"
evaluations = {}
population = 20
"""
BUDGET = 3000
ENDED = {"COMPLETED", "FAILED", "CANCELLED", "TIMEOUT", "NODE_FAIL"}


class Site:
    """A user's folder on a cluster, from which jobs are submitted."""

    def __init__(self, cluster: Cluster, home: Path) -> None:
        self.cluster, self.home = cluster, home
        (home / "bin").mkdir(parents=True)
        for name, module in MODULES.items():
            path = home / "bin" / name
            path.write_text(f'#!/bin/bash\nexec {sys.executable} -m {module} "$@"\n')
            path.chmod(0o755)
        for script in SCRIPTS:
            text = script.read_text().replace("--cpus-per-task=16", "--cpus-per-task=1")
            (home / script.name).write_text(text)
        (home / "many.toml").write_text(CAMPAIGN.format(BUDGET))
        port = str(free_port())
        self.environment = {
            "PATH": f"{home / 'bin'}:{os.environ['PATH']}:/usr/sbin:/sbin",
            "QDGRASP_CACHE": str(home / "cache"),
            "QDGRASP_SECURITY": str(home / "security"),
            "QDGRASP_CONNECT": f"tls/127.0.0.1:{port}",
            "QDGRASP_PORT": port,
            "QDGRASP_NODES": "1",
            "TMPDIR": str(home),
        }
        self.run("security", "init", "security", "--host", "127.0.0.1")

    def run(self, *words: str) -> None:
        """Run `qdgrasp` outside of the cluster."""
        command = [sys.executable, "-m", "qdgrasp", *words]
        environment = os.environ | self.environment
        done = subprocess.run(
            command, cwd=self.home, env=environment, check=False, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr

    def submit(self, *options: str) -> str:
        """Submit the head, and return its job."""
        words = ("sbatch", "--parsable", f"--chdir={self.home}", *options, str(self.home / "head.sbatch"))
        return self.cluster.command(*words, "many.toml", str(self.home / "many"), **self.environment)

    @property
    def rows(self) -> int:
        """The number of rows on the disk."""
        return rows_recorded(self.home / "many")

    def finish(self, job: str) -> None:
        """Wait for the end of the head, however often it is queued again, and of its workers."""
        wait_for(lambda: self.cluster.state(job) in ENDED, "the end of the head", 600.0)
        assert self.cluster.state(job) == "COMPLETED", self.logs
        wait_for(lambda: not self.cluster.jobs("qdgrasp-workers"), "the end of its workers")

    @property
    def logs(self) -> str:
        """All that its jobs have said."""
        return "\n".join(path.read_text() for path in sorted(self.home.glob("*.log")))


def digest(campaign: Path) -> str:
    (run,) = (campaign / "runs").glob("[!.]*")
    with RunFolder.open(run).journal() as journal:
        return journal_digest(journal)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with running_cluster(tmp_path_factory.mktemp("cluster")) as cluster:
        yield cluster


@pytest.fixture(scope="module")
def undisturbed(cluster: Cluster, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The digest of the campaign, carried out without Slurm."""
    site = Site(cluster, tmp_path_factory.mktemp("undisturbed"))
    site.run(
        "campaign", "many.toml", "--out", "many", "--workers", "1", "--listen", f"tls/127.0.0.1:{free_port()}"
    )
    return digest(site.home / "many")


@pytest.fixture
def site(cluster: Cluster, tmp_path: Path) -> Site:
    return Site(cluster, tmp_path)


def test_a_head_that_is_signalled_is_queued_again_and_goes_on(site: Site, undisturbed: str) -> None:
    job = site.submit()
    wait_for(lambda: site.rows, "rows")
    site.cluster.command("scancel", "--signal=TERM", job)
    wait_for(lambda: site.cluster.restarts(job) == 1, "another turn of the head")
    assert site.rows < BUDGET
    site.finish(job)
    assert digest(site.home / "many") == undisturbed


SIGNAL = ("scancel", "--signal=TERM", "{workers}")
NEED_OF_ROOM = (
    "sbatch", "--partition=urgent", "--cpus-per-task=14", "--wait", "--output=/dev/null", "--wrap=true"
)  # fmt: skip


@pytest.mark.parametrize("command", [SIGNAL, NEED_OF_ROOM], ids=["signalled", "to make room"])
def test_workers_that_end_for_the_cluster_are_queued_again_and_go_on(site, undisturbed, command) -> None:
    job = site.submit()
    wait_for(lambda: site.rows, "rows")
    (workers,) = site.cluster.jobs("qdgrasp-workers")
    site.cluster.command(*(word.format(workers=workers) for word in command))
    wait_for(lambda: site.cluster.restarts(workers) == 1, "another turn of the workers")
    site.finish(job)
    assert digest(site.home / "many") == undisturbed


def test_a_head_whose_time_is_over_is_queued_again_until_it_is_done(site: Site, undisturbed: str) -> None:
    job = site.submit("--time=1", "--signal=TERM@50")
    wait_for(lambda: site.cluster.restarts(job) == 1, "another turn of the head")
    assert site.rows < BUDGET
    site.cluster.command("scontrol", "update", f"JobId={job}", "TimeLimit=60")
    site.finish(job)
    assert digest(site.home / "many") == undisturbed


def test_a_head_that_is_cancelled_stays_away_and_takes_its_workers_along(site: Site) -> None:
    job = site.submit()
    wait_for(lambda: site.rows, "rows")
    site.cluster.command("scancel", job)
    wait_for(lambda: not site.cluster.jobs("qdgrasp-head"), "the end of the head")
    wait_for(lambda: not site.cluster.jobs("qdgrasp-workers"), "the end of its workers")
    assert (site.cluster.state(job), site.cluster.restarts(job)) == ("CANCELLED", 0)
