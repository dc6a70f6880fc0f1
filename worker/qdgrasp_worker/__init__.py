"""The stateless evaluator: a genome goes in, an outcome comes out."""
