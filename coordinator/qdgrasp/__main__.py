"""`python -m qdgrasp`: the same as the command `qdgrasp`."""

from qdgrasp.entry import qdgrasp

qdgrasp()
