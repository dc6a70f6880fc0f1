import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.common import PATIENCE, free_port
from tests.deploy.commands import DEPLOY, filled, understood

from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_protocol.process import GRACE
from qdgrasp_tools.campaign.campaign_file import read_campaign
from qdgrasp_tools.campaign.campaign_folder import CampaignRunQueue

SLURM = DEPLOY / "slurm"
SCRIPTS = sorted(SLURM.glob("*.sbatch"))
MODULES = {"qdgrasp": "qdgrasp", "qdgrasp-worker": "qdgrasp_worker.cli"}
ROUTER = "tls/head:7447"
VALUES = {"QDGRASP_CONNECT": ROUTER, "campaign": "many.toml", "folder": "/scratch/many", "port": "7447"}
SHELL = re.compile(r"\$\{\w+:-([^}]*)\}")
CAMPAIGN = """
[[cross]]
gripper = "panda"
object = "tennis_ball"
method = "contact_rand"
evaluations = 40
population = 20
"""


def options(script: Path) -> dict[str, str]:
    """The options of Slurm in a script."""
    return dict(re.findall(r"^#SBATCH --([\w-]+)=?(.*)$", script.read_text(), re.MULTILINE))


def command(script: Path) -> list[str]:
    """The command that it starts, behind `srun` and its options."""
    (line,) = re.findall(r"^srun (.*)$", script.read_text().replace("\\\n", " "), re.MULTILINE)
    line = re.sub(r"\$\{USER:-\w+\}|\$\{TMPDIR:-/tmp\}", "x", line)
    words = shlex.split(SHELL.sub(r"\1", line))
    first = next(place for place, word in enumerate(words) if not word.startswith("-"))
    return filled(shlex.join(words[first:]).replace("'", ""), VALUES)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_script_is_one_and_starts_a_command_with_options_that_it_has(script: Path) -> None:
    subprocess.run(["/bin/bash", "-n", str(script)], check=True)
    assert understood(command(script))


def test_workers_are_done_before_their_time_is_over() -> None:
    script = SLURM / "workers.sbatch"
    left = float(options(script)["signal"].partition("@")[2])
    assert understood(command(script))["grace"] + GRACE <= left


def test_a_worker_has_the_memory_that_its_simulator_may_keep() -> None:
    script = SLURM / "workers.sbatch"
    given = float(options(script)["mem-per-cpu"].removesuffix("M"))
    assert given >= understood(command(script))["memory"] * 1.2


def test_a_campaign_is_carried_out_between_head_and_workers(tmp_path: Path) -> None:
    head = Desk(tmp_path)
    done = head.run("head.sbatch", "many.toml", str(tmp_path / "many"))
    assert done.returncode == 0, done.stdout + head.said("workers.log")
    folder = JobFolder.open(tmp_path / "many")
    extent = CampaignRunQueue(folder, read_campaign(tmp_path / "many.toml").runs).extent
    assert (extent.runs, extent.runs_done) == (1, 1)
    assert "joined" in head.said("workers.log")
    assert head.said("scancel.log") == "17\n"
    assert head.said("scontrol.log") == ""


class Desk:
    """A folder from which things are submitted, with stand-ins for Slurm's commands."""

    def __init__(self, home: Path) -> None:
        self._home = home
        (home / "many.toml").write_text(CAMPAIGN)
        (home / "bin").mkdir()
        for script in SCRIPTS:
            (home / script.name).write_text(script.read_text())
        for name, module in MODULES.items():
            self._tool(name, f'exec {sys.executable} -m {module} "$@"')
        self._tool("srun", 'while [[ $1 == -* ]]; do shift; done; exec "$@"')
        submit = "setsid bash workers.sbatch >workers.log 2>&1 & echo $! >pid; echo '17;cluster'"
        self._tool("sbatch", submit)
        self._tool("scancel", 'echo "$@" >>scancel.log; kill -TERM -- -$(cat pid)')
        self._tool("squeue", "echo CANCELLED")
        self._tool("scontrol", 'echo "$@" >>scontrol.log')

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Submit a script, and wait for its end."""
        port = str(free_port())
        environment = os.environ | {
            "PATH": f"{self._home / 'bin'}:{os.environ['PATH']}",
            "QDGRASP_CACHE": str(self._home / "cache"),
            "QDGRASP_SECURITY": str(self._home / "security"),
            "QDGRASP_CONNECT": f"tls/127.0.0.1:{port}",
            "QDGRASP_PORT": port,
            "SLURM_CPUS_PER_TASK": "1",
            "TMPDIR": str(self._home),
        }
        security = ["qdgrasp", "security", "init", "security", "--host", "127.0.0.1"]
        whole: dict[str, Any] = {"cwd": self._home, "env": environment, "text": True, "timeout": PATIENCE}
        for command in (security, ["bash", *words]):
            done = subprocess.run(
                ["/usr/bin/env", *command],
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                check=False,
                **whole,
            )
        return done

    def said(self, name: str) -> str:
        path = self._home / name
        return path.read_text() if path.exists() else ""

    def _tool(self, name: str, line: str) -> None:
        path = self._home / "bin" / name
        path.write_text(f"#!/bin/bash\n{line}\n")
        path.chmod(0o755)
