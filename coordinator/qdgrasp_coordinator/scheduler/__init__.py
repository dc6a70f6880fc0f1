"""The coordinator: runs, batches, workers and leases, and what it hears and tells on the bus."""
