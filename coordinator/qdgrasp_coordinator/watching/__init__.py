"""What the one who started a job does: starts its processes, and shows how far they are."""
