"""Grippers, objects and the scene bundle made of one of each."""
