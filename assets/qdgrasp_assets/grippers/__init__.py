"""Grippers: their files and checks, the hand model, and the built-in hands."""
