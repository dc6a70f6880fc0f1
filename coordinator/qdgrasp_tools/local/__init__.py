"""Jobs on one machine: starts their processes, restarts them, and shows how far they are."""
