"""The worker as a service: jobs, batches, and the simulator's process."""
