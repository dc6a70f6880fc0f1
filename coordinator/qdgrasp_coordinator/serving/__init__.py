"""The coordinator as a service: its lanes, its turn, what it hears and tells."""
