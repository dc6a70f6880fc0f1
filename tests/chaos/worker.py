"""A worker with simulators of this folder: `python -m tests.chaos.worker [OPTIONS]`; see SIMULATOR."""

import os
import sys

from qdgrasp_worker import cli
from qdgrasp_worker.runtime import simulator_supervisor

SIMULATOR = "CHAOS_SIMULATOR"
"""Names the module of the simulators; by default those that take their time."""


if __name__ == "__main__":
    simulator_supervisor.SIMULATOR_COMMAND = [
        sys.executable,
        "-m",
        os.environ.get(SIMULATOR, "tests.chaos.slow_simulator"),
    ]
    cli.main()
