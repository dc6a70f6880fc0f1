"""Fitness: how its three values are coloured and called, in pictures and on the page alike."""

COLOURS = ("#bdb7ad", "#f2a431", "#2a73b9")
"""Of fitness 0, 1 and 2; told apart with any colour vision, and by their lightness alone."""
WORDS = ("no shake survived", "one shake survived", "both survived")
"""What they mean."""
