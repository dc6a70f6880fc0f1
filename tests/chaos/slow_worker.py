"""A worker whose simulators take their time: `python -m tests.chaos.slow_worker [OPTIONS]`.

Its results are those of `qdgrasp-worker`, later.
"""

import sys

from qdgrasp_worker import cli
from qdgrasp_worker.serving import workshop

if __name__ == "__main__":
    workshop.CHILD = [sys.executable, "-m", "tests.chaos.slow_simulator"]
    cli.main()
