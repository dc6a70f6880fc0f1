"""Faults that a command has listed already, in the sentence that it ends with."""

from collections.abc import Collection


def listed(faults: Collection[str]) -> str:
    """What is to be corrected, for the end of a sentence: each is told once, in the list."""
    return "the fault that is listed" if len(faults) == 1 else f"the {len(faults)} faults that are listed"
