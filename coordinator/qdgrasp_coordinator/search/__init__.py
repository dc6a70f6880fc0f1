"""The search methods: ask for genomes, tell their results."""
