"""Replays of single evaluations, recorded and rendered."""
