"""One run: its search, the order of its asks and tells, what it is prepared from."""
