"""Small runs from beginning to end: their digests, and the platform that these hold on.

A campaign of every kind of search, with four hands and the three protocols, and a reranking of one of its
runs. Everything is built in, so that a fresh clone has it.
"""

import os
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import tomli_w
from tests.common import own_endpoint

from qdgrasp_coordinator.storage.run_folder import RunFolder, journal_digest
from qdgrasp_worker.platform import probe_digest

HERE = Path(__file__).parent
CAMPAIGN = HERE / "campaign.toml"
DIGESTS = HERE / "files" / "digests.toml"
RERANKED = "panda-tennis_ball-antipodal_me_scs-s0-population20"
"""The run of the campaign whose best grasps are scored again."""
PACKAGES = ("pybullet", "numpy", "scipy", "ribs")


def platform() -> dict[str, str]:
    """The packages and the machine that digests depend on besides this package."""
    found = {name: version(name) for name in PACKAGES}
    return found | {"mujoco": mujoco.__version__, "machine": os.uname().machine}


def golden() -> dict[str, Any]:
    """The golden digests, and the platform on which they were made."""
    return tomllib.loads(DIGESTS.read_text(encoding="utf-8"))


def digest_text() -> str:
    """The platform with the digest of its probes, and the digest and the scene of every run."""
    with TemporaryDirectory() as folder:
        runs = digests(Path(folder))
    return tomli_w.dumps({"platform": platform(), "probes": probe_digest(), "runs": runs})


def digests(home: Path) -> dict[str, dict[str, str]]:
    """Digests of the rows and the scenes of the campaign's runs and of the reranking, by name."""
    carry_out(home, "campaign", CAMPAIGN, "--out", "campaign")
    carry_out(home, "rerank", f"campaign/runs/{RERANKED}", "--top", 2, "--out", "reranked")
    folders = [*sorted((home / "campaign" / "runs").iterdir()), home / "reranked"]
    return {folder.name: digests_of(RunFolder.open(folder)) for folder in folders}


def digests_of(folder: RunFolder) -> dict[str, str]:
    """The sha256 over a run's rows in order, which `qdgrasp digest` prints, and that of its scene."""
    with folder.journal() as journal:
        return {"digest": journal_digest(journal), "scene": journal.scene}


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
