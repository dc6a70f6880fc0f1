"""The command line: one module per command of `qdgrasp`, and one per process it starts."""
