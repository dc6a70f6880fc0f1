"""Small runs from beginning to end: their digests, and the platform that these hold on.

A campaign of every kind of search, with four hands and the three protocols, and a reranking of one of its
runs. Everything is built in, so that a fresh clone has it.
"""

import hashlib
import os
import shutil
import subprocess
import sys
import tomllib
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import tomli_w
from tests.common import own_endpoint

import qdgrasp
from qdgrasp_coordinator.metrics.arrays import reshape_rows
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_worker.platform import probe_digest

HERE = Path(__file__).parent
CAMPAIGN = HERE / "campaign.toml"
RECORDED = HERE / "recorded_0_1_0"
"""Folders of version 0.1.0: a run that is `finished`, the same one `begun`, and `pruned`."""
DIGESTS = HERE / "files" / "digests.toml"
RERANKED = "panda-tennis_ball-antipodal_me_scs-s0-population20"
"""The run of the campaign whose best grasps are scored again."""
EXTENDED = 90
"""The budget to which the recorded run is extended."""
PACKAGES = ("pybullet", "numpy", "scipy", "ribs")


def platform() -> dict[str, str]:
    """The packages and the machine that digests depend on besides this package."""
    return {name: version(name) for name in PACKAGES} | {"machine": os.uname().machine}


def golden() -> dict[str, Any]:
    """The golden digests, and the platform on which they were made."""
    return tomllib.loads(DIGESTS.read_text(encoding="utf-8"))


def digest_text() -> str:
    """The platform with the digest of its probes, and the digest and the scene of every run."""
    with TemporaryDirectory() as folder:
        runs = digests(Path(folder))
    return tomli_w.dumps({"platform": platform(), "probes": probe_digest(), "runs": runs})


def digests(home: Path) -> dict[str, dict[str, str]]:
    """Digests of the campaign's runs, the reranking, the recording and its extension, by name."""
    carry_out(home, "campaign", CAMPAIGN, "--out", "campaign")
    carry_out(home, "rerank", f"campaign/runs/{RERANKED}", "--top", 2, "--trials", "all", "--out", "reranked")
    for name in ("finished", "extended"):
        shutil.copytree(RECORDED / "finished", home / name)
    carry_out(home, "resume", "extended", "--evaluations", EXTENDED)
    alone = [home / name for name in ("reranked", "finished", "extended")]
    folders = [*sorted((home / "campaign" / "runs").iterdir()), *alone]
    return {
        folder.name: digests_of(folder) | {"scene": sha256((folder / "scene.bundle").read_bytes())}
        for folder in folders
    }


def digests_of(folder: Path) -> dict[str, str]:
    """The sha256 over a run's rows in order, which `qdgrasp digest` prints, and over those of 0.1.0 alone."""
    with RunFolder.open(folder).journal() as journal:
        rows, shape = journal.rows(0, journal.count), journal.shape
    first = reshape_rows(rows, replace(shape, contact_slots=0))
    return {"digest": sha256(rows.tobytes()), "first_columns": sha256(first.tobytes())}


def sha256(content: bytes) -> str:
    """The sha256 of some bytes in hex."""
    return hashlib.sha256(content).hexdigest()


def carry_out(home: Path, *words: object) -> str:
    """Run a command that evaluates, with two workers, on a port of its own; give its output."""
    return command(home, *words, "--workers", 2, "--listen", own_endpoint())


def command(home: Path, *words: object) -> str:
    """Run a command in a folder; give its output."""
    line = [sys.executable, "-m", "qdgrasp", *map(str, words)]
    environment = os.environ | {"QDGRASP_CACHE": str(home / "cache")}
    ended = subprocess.run(line, cwd=home, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def exported(name: str) -> str:
    """The grasps of the recorded run in a format, without the version of the package."""
    with TemporaryDirectory() as folder:
        home = Path(folder)
        shutil.copytree(RECORDED / "finished", home / "finished")
        command(home, "export", "finished", "--format", name, "--out", "grasps")
        return (home / "grasps").read_text().replace(f"qdgrasp: {qdgrasp.__version__}", "qdgrasp: VERSION", 1)
