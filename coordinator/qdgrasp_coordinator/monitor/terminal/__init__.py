"""The monitor on a terminal: tables, curves and events that fit the room there is."""
