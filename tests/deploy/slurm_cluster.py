"""A cluster of Slurm on this machine alone: its own munged, slurmctld and slurmd, in a folder of its own.

They listen on loopback and run as root. The one node is said to have more cores and memory than the machine
has, as most of what runs on it waits.
"""

import getpass
import os
import secrets
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from tests.common import PATIENCE, free_port, wait_for

NEEDED = ("munged", "slurmctld", "slurmd", "slurmstepd", "sbatch", "scontrol", "squeue", "scancel")
CONFIGURATION = """
ClusterName=loopback
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller}
SlurmdPort={node}
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={home}/munge.socket,cred_expire=5
CredType=cred/munge
StateSaveLocation={home}/state
SlurmdSpoolDir={home}/spool
SlurmctldPidFile={home}/slurmctld.pid
SlurmdPidFile={home}/slurmd.pid
ProctrackType={tracking}
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
SlurmdParameters=config_overrides
MpiDefault=none
ReturnToService=2
KillWait=5
OverTimeLimit=0
MinJobAge=3600
SchedulerParameters=bf_interval=1,sched_interval=2
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
NodeName={host} NodeAddr=127.0.0.1 CPUs=16 RealMemory=64000
PartitionName=usual Nodes={host} Default=YES PriorityTier=1 GraceTime=60 MaxTime=INFINITE
PartitionName=urgent Nodes={host} PriorityTier=2 PreemptMode=OFF MaxTime=INFINITE
"""
LONGEST_START = 60.0  # seconds in which a daemon answers


def obstacle() -> str:
    """Return why there can be no cluster here; empty where there can be one."""
    path = f"{os.environ['PATH']}:/usr/sbin:/sbin"
    if missing := [name for name in NEEDED if shutil.which(name, path=path) is None]:
        return f"needs {', '.join(missing)}: apt-get install slurmctld slurmd slurm-client munge"
    return "" if os.geteuid() == 0 else "needs root, as slurmd does"


class Cluster:
    """A cluster that is up."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._environment = dict(environment)

    def command(self, *words: str, **environment: str) -> str:
        """Run one of Slurm's commands, and return its output."""
        whole = self._environment | environment
        done = subprocess.run(words, env=whole, capture_output=True, text=True, check=False, timeout=PATIENCE)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout.strip()

    def state(self, job: str) -> str:
        """Return the state of a job, such as RUNNING."""
        return self.command("scontrol", "-o", "show", "job", job).partition("JobState=")[2].split()[0]

    def restarts(self, job: str) -> int:
        """Return how often a job was queued again."""
        return int(self.command("scontrol", "-o", "show", "job", job).partition("Restarts=")[2].split()[0])

    def jobs(self, name: str) -> list[str]:
        """Return the ids of the jobs of a name that wait or run, elements of arrays one by one."""
        return self.command("squeue", "-h", "-r", "-n", name, "-o", "%A").split()


@contextmanager
def running_cluster(home: Path, tracking: str = "proctrack/linuxproc") -> Iterator[Cluster]:
    """Bring up a cluster in a folder; at the end its jobs are cancelled and its daemons ended, by pid."""
    host, conf = socket.gethostname().partition(".")[0], home / "slurm.conf"
    for name in ("state", "spool"):
        (home / name).mkdir(parents=True)
    ports = {"controller": free_port(), "node": free_port()}
    conf.write_text(CONFIGURATION.format(home=home, host=host, tracking=tracking, **ports))
    (home / "cgroup.conf").write_text("CgroupAutomount=no\n")
    key = home / "munge.key"
    key.touch(mode=0o600)
    key.write_bytes(secrets.token_bytes(1024))
    environment = os.environ | {
        "PATH": f"{os.environ['PATH']}:/usr/sbin:/sbin",
        "SLURM_CONF": str(conf),
        "USER": getpass.getuser(),
    }
    cluster = Cluster(environment)
    with ExitStack() as stack:
        munged = ["munged", "--foreground", "--force", f"--key-file={key}", f"--socket={home}/munge.socket"]
        munged += [f"--{kind}-file={home}/munged.{kind}" for kind in ("pid", "log", "seed")]
        stack.enter_context(_daemon(munged, home, environment))
        wait_for((home / "munge.socket").exists, "munged")
        stack.enter_context(_daemon(["slurmctld", "-D", "-c", "-f", str(conf)], home, environment))
        stack.enter_context(_daemon(["slurmd", "-D", "-f", str(conf), "-N", host], home, environment))
        wait_for(lambda: _says_idle(environment), "a node")
        stack.callback(_cancel_all, cluster)
        yield cluster


def _says_idle(environment: Mapping[str, str]) -> bool:
    asked = ("/usr/bin/env", "sinfo", "-h", "-p", "usual", "-o", "%t")
    done = subprocess.run(asked, env=environment, capture_output=True, text=True, check=False)
    return done.stdout.strip() == "idle"


def _cancel_all(cluster: Cluster) -> None:
    cluster.command("scancel", "--user", getpass.getuser())
    end = time.monotonic() + LONGEST_START
    while cluster.command("squeue", "-h") and time.monotonic() < end:
        time.sleep(0.2)


@contextmanager
def _daemon(words: list[str], home: Path, environment: Mapping[str, str]) -> Iterator[None]:
    with (home / f"{words[0]}.out").open("wb") as said:
        process = subprocess.Popen(
            words, env=environment, stdin=subprocess.DEVNULL, stdout=said, stderr=said, cwd=home
        )
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(LONGEST_START)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
