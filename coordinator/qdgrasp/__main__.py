"""`python -m qdgrasp`: the same as the command `qdgrasp`."""

from qdgrasp_coordinator.cli.main import main

main()
