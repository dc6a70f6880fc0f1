"""What is done with runs that are there: joined, pruned, ranked, made smaller."""
