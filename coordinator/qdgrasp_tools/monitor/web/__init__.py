"""The page of `qdgrasp-monitor --web`, and the small server behind it."""
