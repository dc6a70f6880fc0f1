"""Grasps as other tools take them: choosing, writing and reading."""
