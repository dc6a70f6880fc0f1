"""Endpoints for tests that run beside others."""

import socket


def own_endpoint() -> str:
    """One on a port that is free now, and never the default one: runs in other tests listen there."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return f"tcp/127.0.0.1:{server.getsockname()[1]}"
