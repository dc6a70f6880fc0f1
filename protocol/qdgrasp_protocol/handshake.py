"""Why a router cannot be reached, found out by one more try with nothing but a socket."""

import socket
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from qdgrasp_protocol.credentials import Credentials
from qdgrasp_protocol.endpoint import Endpoint
from qdgrasp_protocol.errors import EndpointError

if TYPE_CHECKING:
    import ssl

DOUBT = "; is the coordinator or router running there, and the port reachable? Name another with --connect."
PATIENCE = 2.0  # seconds that the other side may take for one step
HESITATION = 0.5  # seconds in which it says whether it takes our certificate; it waits for us to speak first


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

    context = ssl.create_default_context(cafile=str(credentials.authority))
    try:
        context.load_cert_chain(credentials.certificate, credentials.key)
    except (OSError, ssl.SSLError) as error:
        return f"{credentials.certificate} and its key cannot be used ({_reason(error)})."
    try:
        greet(endpoint, context)
    except ssl.SSLCertVerificationError as error:
        return f"the certificate it shows is not good ({error.verify_message})."
    except ssl.SSLError as error:
        return f"it does not take {credentials.certificate} ({_reason(error)})."
    except OSError:
        return ""
    return ""


def greet(endpoint: Endpoint, context: "ssl.SSLContext") -> None:
    """Shake hands with a router, and leave.

    Raises
    ------
    ssl.SSLError
        One side does not trust the other.
    OSError
        Nobody listens there.
    """
    with (
        socket.create_connection((endpoint.host, endpoint.port), PATIENCE) as plain,
        context.wrap_socket(plain, server_hostname=endpoint.host) as link,
    ):
        link.settimeout(HESITATION)
        with suppress(TimeoutError):
            link.recv(1)  # a router that does not take our certificate says so only now


def _reason(error: OSError) -> str:
    reason = getattr(error, "reason", None) or error.strerror or type(error).__name__
    return str(reason).lower().replace("_", " ")
