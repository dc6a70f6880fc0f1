"""The monitor on a terminal: tables, curves and events that fit its size."""
