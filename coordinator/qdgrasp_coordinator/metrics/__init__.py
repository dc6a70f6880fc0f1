"""Counts, scores and bins over the rows of runs: functions of rows, without files or a bus."""
