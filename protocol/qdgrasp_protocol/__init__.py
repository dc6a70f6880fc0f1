"""The contract between processes: specs, rows, messages and the bus they travel on."""
