"""Why a session could not be opened, in a sentence; found out by one more try with nothing but a socket."""

import re
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
SYSTEM_ERROR = re.compile(r"([A-Z][a-z ]+) \(os error")
SOURCE_PLACE = re.compile(r" at /\S+\.rs:[0-9]+\.?")
MOST = 300
"""The most characters that are repeated of what zenoh says."""
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


class NotListening(EndpointError):
    """A router cannot listen.

    Parameters
    ----------
    endpoint
        Where.
    error
        What zenoh says.
    """

    def __init__(self, endpoint: str, error: str) -> None:
        why = SYSTEM_ERROR.search(error)
        if why:
            super().__init__(
                f"Cannot listen on {endpoint}: {why[1].lower()}; name another endpoint with --listen."
            )
        else:
            super().__init__(f"Cannot listen on {endpoint}: zenoh says '{plain(error)}'.")


def plain(error: str) -> str:
    """What zenoh says, without the places in its source, on one line."""
    return " ".join(SOURCE_PLACE.sub("", error).split())[:MOST].rstrip(".")


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


def greet(endpoint: Endpoint, context: "ssl.SSLContext") -> bool:
    """Shake hands with a router, and leave; whether it would have kept the link.

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
            return bool(link.recv(1))  # a router that does not take our certificate says so only now
        return True


def _reason(error: OSError) -> str:
    reason = getattr(error, "reason", None) or error.strerror or type(error).__name__
    return str(reason).lower().replace("_", " ")
