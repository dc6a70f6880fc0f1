"""Why a router cannot be reached, found out by one more try with nothing but a socket."""

import socket
from collections.abc import Sequence

from qdgrasp_protocol.credentials import Credentials
from qdgrasp_protocol.endpoint import Endpoint
from qdgrasp_protocol.errors import EndpointError

DOUBT = "; is the coordinator or router running there, and the port reachable? Name another with --connect."
PATIENCE = 2.0  # seconds that the other side may take for one step


class Unreachable(EndpointError):
    """No router answers, with the reason for encrypted endpoints.

    Parameters
    ----------
    endpoints
        All that were tried.
    seconds
        For how long.
    credentials
        What the session showed.
    """

    def __init__(
        self, endpoints: Sequence[Endpoint], seconds: float, credentials: Credentials | None
    ) -> None:
        names = ", ".join(endpoint.text for endpoint in endpoints)
        reasons = [why_not(endpoint, credentials) for endpoint in endpoints] if credentials else []
        known = " ".join(filter(None, reasons))
        silent = f"Nothing answers at {names} after {seconds:g} s{DOUBT}"
        super().__init__(f"No session at {names}: {known}" if known else silent)


def why_not(endpoint: Endpoint, credentials: Credentials) -> str:
    """Why a handshake at an encrypted endpoint fails; empty where it does not, or where nobody listens."""
    import ssl  # a worker that is welcome need not load it

    try:
        context = ssl.create_default_context(cafile=str(credentials.authority))
        context.load_cert_chain(credentials.certificate, credentials.key)
    except (OSError, ssl.SSLError) as error:
        return f"{credentials.certificate} and its key cannot be used ({_reason(error)})."
    try:
        with (
            socket.create_connection((endpoint.host, endpoint.port), PATIENCE) as plain,
            context.wrap_socket(plain, server_hostname=endpoint.host) as link,
        ):
            link.settimeout(PATIENCE / 4)
            link.recv(1)  # a router that does not take our certificate says so only now
    except ssl.SSLCertVerificationError as error:
        return f"the certificate it shows is not good ({error.verify_message})."
    except ssl.SSLError as error:
        return f"it does not take {credentials.certificate} ({_reason(error)})."
    except OSError:
        return ""
    return ""


def _reason(error: OSError) -> str:
    reason = getattr(error, "reason", None) or error.strerror or type(error).__name__
    return str(reason).lower().replace("_", " ")
