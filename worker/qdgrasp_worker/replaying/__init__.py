"""Replaying: one evaluation is carried out again, and drawn; nothing of it has a say in results."""
