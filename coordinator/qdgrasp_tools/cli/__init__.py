"""The command line: one module per topic of `qdgrasp`, and one per process it starts."""
