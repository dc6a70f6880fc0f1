"""The coordinator: runs, batches, workers and leases, and its messages on the bus."""
