"""Campaigns, many runs of one job; and runs summed up, merged, pruned and ranked."""
