"""Evaluates recorded rows again, to compare them bit for bit or to show one as a picture."""
