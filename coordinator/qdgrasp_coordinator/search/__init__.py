"""The search methods: ask for genomes, tell what they gave."""
