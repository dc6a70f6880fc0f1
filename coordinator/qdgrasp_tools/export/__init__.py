"""Grasps as files of other tools: chosen and written, or read and checked."""
