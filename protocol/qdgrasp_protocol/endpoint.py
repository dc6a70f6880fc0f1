"""Endpoints: where a session listens or connects, and whether strangers could get there."""

import ipaddress
import re
from dataclasses import dataclass

import structlog

from qdgrasp_protocol.errors import EndpointError

log = structlog.get_logger()

HOME, PORT = "127.0.0.1", 7447
HOST_AND_PORT = re.compile(r"(?P<protocol>tcp|tls|quic|udp|ws)/(?P<host>[^\s,]+):(?P<port>[0-9]{1,5})(#\S+)?")
SOCKET_FILE = re.compile(r"(?P<protocol>unixsock-stream)/[^\s,]+")
ENCRYPTED = frozenset({"tls", "quic"})


@dataclass(frozen=True)
class Endpoint:
    """A place on the network, such as `tls/head:7447`.

    Attributes
    ----------
    text
        As it was written.
    protocol
        `tcp`, `tls` ...
    host
        A name or an address; empty for a socket file.
    port
        0 for a socket file.
    """

    text: str
    protocol: str
    host: str = ""
    port: int = 0

    @classmethod
    def parse(cls, text: str) -> "Endpoint":
        """Read one endpoint.

        Raises
        ------
        EndpointError
            The text is not an endpoint.
        """
        if match := HOST_AND_PORT.fullmatch(text):
            host = match["host"].removeprefix("[").removesuffix("]")
            if (port := int(match["port"])) < 1 << 16:
                return cls(text, match["protocol"], host, port)
        elif match := SOCKET_FILE.fullmatch(text):
            return cls(text, match["protocol"])
        raise EndpointError(f"'{text}' is not an endpoint; write it as tcp/HOST:PORT or tls/HOST:PORT.")

    @property
    def is_encrypted(self) -> bool:
        """Needs certificates, and is protected by them."""
        return self.protocol in ENCRYPTED

    @property
    def is_local(self) -> bool:
        """Only this machine gets there."""
        if not self.host:
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"

    @property
    def from_here(self) -> str:
        """Where sessions on this machine get there: over loopback, where it listens everywhere."""
        try:
            address = ipaddress.ip_address(self.host)
        except ValueError:
            return self.text
        if not address.is_unspecified:
            return self.text
        return f"{self.protocol}/{HOME if address.version == 4 else '[::1]'}:{self.port}"


def parse_all(text: str) -> tuple[Endpoint, ...]:
    """Read endpoints that are separated by commas, one or more.

    Raises
    ------
    EndpointError
        A part of the text is not an endpoint.
    """
    return tuple(Endpoint.parse(part) for part in text.split(","))


def home(*, encrypted: bool) -> Endpoint:
    """The default endpoint: on loopback."""
    protocol = "tls" if encrypted else "tcp"
    return Endpoint(f"{protocol}/{HOME}:{PORT}", protocol, HOME, PORT)


def check_open(endpoint: Endpoint, *, insecure: bool) -> None:
    """See that no stranger gets to where a router listens, or that this is what was asked for.

    Raises
    ------
    EndpointError
        Other machines get there, it is not encrypted, and nobody said that this is meant.
    """
    if endpoint.is_local or endpoint.is_encrypted:
        return
    if not insecure:
        raise EndpointError(
            f"Whoever reaches {endpoint.text} could read everything and forge results; listen on "
            f"tls/{endpoint.host}:{endpoint.port} with --security DIR (`qdgrasp security init` writes one), "
            "or, on a network that you trust, add --insecure."
        )
    log.warning("not encrypted: whoever gets here can read and forge everything", endpoint=endpoint.text)
