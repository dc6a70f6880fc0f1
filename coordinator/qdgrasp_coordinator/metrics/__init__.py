"""Counts, scores and bins over the rows of runs; plain functions of rows, without files or a bus."""
