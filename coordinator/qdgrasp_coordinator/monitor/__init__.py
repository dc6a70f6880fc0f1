"""Watching jobs without touching them: what is heard of them, on a terminal, a page and in metrics."""
