"""Many runs under one name: how they are written down, begun, counted."""
