"""How long tests wait for what is to happen: so long that a machine that others use never fails one."""

PATIENCE = 120.0
"""Seconds; whoever waits is told at once when it happens, and a test that waits in vain fails after that."""
