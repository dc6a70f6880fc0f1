"""The search, its archive, the dispatch of its genomes and the record of its outcomes."""
