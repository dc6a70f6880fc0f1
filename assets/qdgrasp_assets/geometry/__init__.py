"""Meshes, rotations and queries on them: files, repair, surface points and collision parts."""
