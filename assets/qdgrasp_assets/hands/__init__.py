"""Hands that users bring: what their URDFs say, what can be guessed of how they grasp, and what is wrong."""
