"""The monitor: models of running jobs, and where they are shown."""
