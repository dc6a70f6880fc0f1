"""What is counted and known of a run: its stretches, cells, niches, poses, figures."""
