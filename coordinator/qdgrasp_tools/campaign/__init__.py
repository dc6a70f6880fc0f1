"""Campaigns, many runs of one job; and runs summed up and ranked."""
