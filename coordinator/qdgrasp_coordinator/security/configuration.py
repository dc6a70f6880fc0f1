"""A zenoh configuration for each role: for `zenohd`, `qdgrasp-router` and zenoh's own tools."""

from qdgrasp_coordinator.security.access import access_list
from qdgrasp_protocol.credentials import Credentials, Role
from qdgrasp_protocol.endpoint import PORT, Endpoint
from qdgrasp_protocol.session import settings, to_json5

EVERYWHERE = "0.0.0.0"  # noqa: S104  # links are encrypted, and both sides show certificates
ROUTER = """\
A router of qdgrasp: `zenohd -c router.json5` or `qdgrasp-router --security DIR` reads it.
Written by `qdgrasp security init`: mutual TLS, and whatever is not allowed here is denied.
"""
CLIENT = """\
A session with the rights of the {role}, for zenoh's own tools: `z_sub -c {role}.json5 -k KEY`.
Written by `qdgrasp security init`; the commands of qdgrasp need only `--security DIR`.
"""


def configuration(credentials: Credentials, host: str) -> str:
    """The configuration file of a role.

    Parameters
    ----------
    credentials
        Whose, and where the certificates lie.
    host
        By what name or address clients reach the router.
    """
    if credentials.role is Role.ROUTER:
        here = Endpoint.parse(f"tls/{EVERYWHERE}:{PORT}")
        chosen = settings("router", listen=[here], credentials=credentials)
        return to_json5(chosen | access_list(), ROUTER)
    there = Endpoint.parse(f"tls/{f'[{host}]' if ':' in host else host}:{PORT}")
    chosen = settings("client", connect=[there], credentials=credentials, seconds=10.0)
    return to_json5(chosen, CLIENT.format(role=credentials.role))
