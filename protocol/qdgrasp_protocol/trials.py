"""Trials: how many times an evaluation protocol evaluates a grasp again, disturbed each time.

Trial 0 is the nominal evaluation; trials 1 to `trials(protocol)` are drawn (docs/protocols.md).
"""

TRIALS = 100
"""Huber et al. 2024: a hundred trials of two shakes, so that the sum of their fitness is at most 200."""
COUNTS = {"robust": TRIALS}


def trials(protocol: str) -> int:
    """How many trials there are besides the nominal evaluation; 0 where a protocol has none."""
    return COUNTS.get(protocol, 0)
