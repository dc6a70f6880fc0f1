"""A worker with the simulators of this folder: `python -m tests.chaos.worker [OPTIONS]`."""

import sys

from qdgrasp_worker import cli
from qdgrasp_worker.runtime import simulator_supervisor

if __name__ == "__main__":
    simulator_supervisor.SIMULATOR_COMMAND = [sys.executable, "-m", "tests.chaos.simulator"]
    cli.main()
