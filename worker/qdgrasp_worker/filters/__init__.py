"""Filters of poses that need no simulation: the hand overlaps, or surely misses."""
