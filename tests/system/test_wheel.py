"""The wheel alone, away from the checkout."""

import os
import subprocess
import sys
import venv
from pathlib import Path

import pytest

from qdgrasp_coordinator.storage.run_folder import RunFolder

ROOT = Path(__file__).parents[2]
RUN = (
    "run",
    "--gripper",
    "panda",
    "--object",
    "tennis_ball",
    "--evaluations",
    "20",
    "--workers",
    "1",
    "--out",
    "run",
)


@pytest.mark.slow
def test_the_wheel_runs_the_main_job_in_a_fresh_environment(tmp_path: Path) -> None:
    def done(*words: object) -> str:
        line = list(map(str, words))
        unset = {"PYTHONPATH", "QDGRASP_ASSET_PATH"}
        clean = {name: value for name, value in os.environ.items() if name not in unset}
        return subprocess.run(
            line, cwd=tmp_path, env=clean, check=True, capture_output=True, text=True
        ).stderr

    pip = ("-m", "pip", "--quiet", "--disable-pip-version-check")
    done(sys.executable, *pip, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", "made", ROOT)
    venv.create(tmp_path / "fresh")
    packages = next((tmp_path / "fresh").glob("lib/python3*/site-packages"))
    (wheel,) = (tmp_path / "made").glob("qdgrasp-*.whl")
    done(
        sys.executable,
        *pip,
        "--python",
        tmp_path / "fresh/bin/python",
        "install",
        "--no-deps",
        "--no-index",
        wheel,
    )
    # Packages of this environment without the checkout: .pth files of a folder named here are not read.
    (packages / "dependencies.pth").write_text(str(next(p for p in sys.path if p.endswith("site-packages"))))
    told = done(tmp_path / "fresh/bin/qdgrasp", *RUN)
    assert told.startswith("building the scene of panda and tennis_ball in ")
    with RunFolder.open(tmp_path / "run").journal() as journal:
        assert journal.count >= 20
