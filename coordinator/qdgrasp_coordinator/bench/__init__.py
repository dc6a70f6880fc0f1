"""What this node makes of a scene: the figures of `qdgrasp bench`, measured on a job over the bus."""
