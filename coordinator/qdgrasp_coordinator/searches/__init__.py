"""The searches: one module per family, each an implementation of `search.Search`."""
