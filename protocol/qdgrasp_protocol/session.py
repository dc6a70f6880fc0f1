"""Sessions on the bus: endpoints, certificates, settings, and reasons of failed openings.

An endpoint is where a session listens or connects. A session proves its role with the files of a folder that
`qdgrasp security init` wrote. One builder makes the settings of every session, for our own processes and for
zenoh's tools.
"""

import ipaddress
import json
import os
import re
import socket
import stat
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Literal

import structlog

from qdgrasp_protocol.errors import EndpointError, SecurityError

log = structlog.get_logger()

LOOPBACK, PORT = "127.0.0.1", 7447
LOOPBACK_OF = {"0.0.0.0": LOOPBACK, "::": "[::1]"}  # noqa: S104  # by the host that stands for all interfaces
HOST_AND_PORT = re.compile(r"(?P<protocol>tcp|tls)/(?P<host>[^\s,]+):(?P<port>[0-9]{1,5})(#\S+)?")
SOCKET_FILE = re.compile(r"(?P<protocol>unixsock-stream)/[^\s,]+")


def _is_host(text: str) -> bool:
    """Return whether a host's name can be looked up: no label of it is empty or too long."""
    try:
        text.encode("idna")
    except UnicodeError:
        return False
    return True


@dataclass(frozen=True)
class Endpoint:
    """A place on the network, such as `tls/head:7447`."""

    text: str
    protocol: str
    host: str = ""
    port: int = 0

    @classmethod
    def parse(cls, text: str) -> "Endpoint":
        """Read one endpoint; an EndpointError if the text is not one."""
        if match := HOST_AND_PORT.fullmatch(text):
            host = match["host"].removeprefix("[").removesuffix("]")
            if (port := int(match["port"])) < 1 << 16 and _is_host(host):
                return cls(text, match["protocol"], host, port)
        elif match := SOCKET_FILE.fullmatch(text):
            return cls(text, match["protocol"])
        raise EndpointError(f"'{text}' is not an endpoint; write it as tcp/HOST:PORT or tls/HOST:PORT.")

    @property
    def is_encrypted(self) -> bool:
        """True if it needs certificates and is protected by them."""
        return self.protocol == "tls"

    @property
    def is_local(self) -> bool:
        """Only this machine gets there."""
        if not self.host:
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"

    def reached_from(self, *, here: bool) -> str:
        """Return the address for sessions on this machine, or on others.

        Where it listens on all interfaces, that is loopback, or this machine's name.
        """
        if self.host not in LOOPBACK_OF:
            return self.text
        return f"{self.protocol}/{LOOPBACK_OF[self.host] if here else socket.gethostname()}:{self.port}"


def parse_endpoints(text: str) -> tuple[Endpoint, ...]:
    """Read endpoints that are separated by commas, one or more."""
    return tuple(Endpoint.parse(part) for part in text.split(","))


def default_endpoint(*, encrypted: bool) -> Endpoint:
    """Return the default endpoint: on loopback."""
    protocol = "tls" if encrypted else "tcp"
    return Endpoint(f"{protocol}/{LOOPBACK}:{PORT}", protocol, LOOPBACK, PORT)


def check_open(endpoint: Endpoint, *, insecure: bool) -> None:
    """Refuse by `EndpointError` an unencrypted endpoint that others reach, unless `insecure`."""
    if endpoint.is_local or endpoint.is_encrypted:
        return
    if not insecure:
        raise EndpointError(
            f"Anyone who reaches {endpoint.text} could read everything and forge results; listen on tls/"
            f"{endpoint.text.partition('/')[2]} with --security DIR (`qdgrasp security init` writes one), "
            "or, on a network that you trust, add --insecure."
        )
    log.warning("not encrypted: anyone who gets here can read and forge everything", endpoint=endpoint.text)


SECURITY_VARIABLE = "QDGRASP_SECURITY"
"""Names the folder for commands that users start; their child processes get a flag instead."""
OTHERS_PERMISSIONS = stat.S_IRWXG | stat.S_IRWXO  # The permissions of all but a key's owner


class Role(StrEnum):
    """Role that a certificate is for; each has one common name, and all workers share one."""

    ROUTER = "router"
    """Relays for all: `qdgrasp-router`, `zenohd`, a coordinator that listens itself."""
    COORDINATOR = "coordinator"
    RECORDER = "recorder"
    WORKER = "worker"
    MONITOR = "monitor"
    """Watches, and sends nothing."""
    ADMIN = "admin"
    """Asks for the state and figures of jobs, and tells a job to pause, go on or end."""

    @property
    def common_name(self) -> str:
        """Common name of its certificates, which the routers' access list uses."""
        return f"qdgrasp-{self.value}"


@dataclass(frozen=True)
class Credentials:
    """The certificate of a role, its key, and the authority of the other side's certificate."""

    folder: Path
    role: Role

    def __str__(self) -> str:
        return f"the {self.role} in {self.folder}"

    @classmethod
    def find(cls, folder: Path | None, role: Role) -> "Credentials | None":
        """The files of a role in a folder, checked; None where no folder was named.

        A SecurityError if one is missing or cannot be read, or others on this machine can read the key.
        """
        if folder is None:
            return None
        found = cls(folder.absolute(), role)
        found.check()
        return found

    @property
    def authority(self) -> Path:
        """The certificate of the authority."""
        return self.folder / "ca.pem"

    @property
    def certificate(self) -> Path:
        """The certificate of the role."""
        return self.folder / f"{self.role}.pem"

    @property
    def key(self) -> Path:
        """The private key of the role."""
        return self.folder / f"{self.role}.key"

    @property
    def configuration(self) -> Path:
        """The zenoh configuration of a router, with the access list."""
        return self.folder / f"{self.role}.json5"

    def check(self) -> None:
        """Check that all files are readable, and that other users cannot read the key."""
        needed = [self.authority, self.certificate, self.key]
        if self.role is Role.ROUTER:
            needed.append(self.configuration)
        try:
            missing = [path.name for path in needed if not path.is_file()]
            if missing:
                raise SecurityError(
                    f"{self.folder} lacks {' and '.join(missing)}, which the {self.role} needs; "
                    "copy them from the folder that `qdgrasp security init` wrote."
                )
            for path in needed:
                path.open("rb").close()
            forbidden = stat.S_IMODE(self.key.stat().st_mode) & _forbidden_permissions(self.key)
        except OSError as error:
            raise SecurityError(
                f"{error.filename} cannot be read ({error.strerror}): the files of a {self.role} are to be "
                "those of the user who runs it."
            ) from None
        if forbidden:
            raise SecurityError(
                f"Others on this machine can read or change {self.key}; `chmod 600 {self.key}` mends it."
            )


def _forbidden_permissions(key: Path) -> int:
    """Return the permissions that a key must not have.

    Kubernetes and systemd hand a key to a service so: it stays root's, and a group of one may read it.
    """
    is_handed_over = key.stat().st_uid == 0 and os.geteuid() != 0
    return OTHERS_PERMISSIONS & ~stat.S_IRGRP if is_handed_over else OTHERS_PERMISSIONS


Mode = Literal["client", "router"]  # Routers relay; all others are clients of them
ZenohSettings = dict[str, object]  # Values by their path in a zenoh configuration

OPEN_SECONDS = 8.0
"""Most seconds for opening a link, the first time and after a cut.

A link with a round trip of 0.6 s takes 2.4 s, and some seconds more where it loses what is sent.
"""
BASE_SETTINGS: ZenohSettings = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "scouting/delay": 0,  # ms; nothing is scouted, so opening a router need not wait for answers
    "transport/shared_memory/enabled": False,
    "transport/unicast/max_sessions": 10_000,
    "transport/unicast/open_timeout": int(1000 * OPEN_SECONDS),  # then another router has its turn
    "transport/link/rx/max_message_size": 17 << 20,  # messages.MAX_PAYLOAD and what stands around it
    "transport/link/tx/lease": 4000,  # ms
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 1_000_000,  # us
}
"""Settings common to all sessions (docs/decisions/0003-bus-sessions-and-access.md)."""
RETRY = {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 1.5}
FOREVER = -1


def session_settings(
    mode: Mode,
    *,
    listen: Iterable[Endpoint] = (),
    connect: Iterable[Endpoint] = (),
    credentials: Credentials | None = None,
    seconds: float = 0.0,
) -> ZenohSettings:
    """The settings of a session, whose endpoints are encrypted where there are credentials.

    A client connects to the first router in `connect` that answers, and to another one when that is lost; a
    router connects to each, now or later. Opening a client may take so many `seconds`; a connection lost
    later is sought for ever.
    """
    listening, connecting = tuple(listen), tuple(connect)
    for endpoint in (*listening, *connecting):
        check_encryption(endpoint, credentials)
    chosen = BASE_SETTINGS | {"mode": mode}
    if listening:
        chosen |= _endpoint_settings("listen", listening, 0, fails=True)
    if connecting:
        patience = int(1000 * seconds) if mode == "client" else FOREVER
        chosen |= _endpoint_settings("connect", connecting, patience, fails=mode == "client")
    return chosen | (_tls_settings(mode, credentials) if credentials else {})


def check_encryption(endpoint: Endpoint, credentials: Credentials | None) -> None:
    """Check that an endpoint is encrypted where, and only where, there are certificates."""
    if endpoint.is_encrypted and credentials is None:
        raise EndpointError(
            f"{endpoint.text} is encrypted and needs certificates: name their folder with --security "
            "(`qdgrasp security init` writes one)."
        )
    if credentials is not None and not endpoint.is_encrypted:
        raise EndpointError(
            f"{endpoint.text} is not encrypted, and --security {credentials.folder} asks for that; "
            "write it as tls/HOST:PORT."
        )


def nest_settings(values: Mapping[str, object]) -> dict[str, Any]:
    """Return settings as the tree that a configuration file holds."""
    tree: dict[str, Any] = {}
    for path, value in values.items():
        *branches, leaf = path.split("/")
        twig = tree
        for branch in branches:
            twig = twig.setdefault(branch, {})
        twig[leaf] = value
    return tree


def to_json5(values: Mapping[str, object], comment: str) -> str:
    """Return a zenoh configuration file with these settings, under a comment."""
    head = "".join(f"// {line}\n" for line in comment.splitlines())
    return f"{head}{json.dumps(nest_settings(values), indent=2)}\n"


def _endpoint_settings(
    verb: str, endpoints: tuple[Endpoint, ...], timeout_ms: int, *, fails: bool
) -> ZenohSettings:
    return {
        f"{verb}/endpoints": [endpoint.text for endpoint in endpoints],
        f"{verb}/timeout_ms": timeout_ms,
        f"{verb}/exit_on_failure": fails,
        f"{verb}/retry": RETRY,
    }


def _tls_settings(mode: Mode, credentials: Credentials) -> ZenohSettings:
    """Return the TLS settings: both sides show a certificate, and links end when it expires."""
    certificate, key = str(credentials.certificate), str(credentials.key)
    shown: ZenohSettings = {"connect_certificate": certificate, "connect_private_key": key}
    if mode == "router":
        shown |= {"listen_certificate": certificate, "listen_private_key": key}
    always: ZenohSettings = {
        "root_ca_certificate": str(credentials.authority),
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }
    return {f"transport/link/tls/{name}": value for name, value in (always | shown).items()}


SOURCE_PLACE = re.compile(r" at /\S+\.rs:[0-9]+\.?")
MAX_ZENOH_ERROR = 300  # The most characters that are repeated of what zenoh says
HANDSHAKE_SECONDS = 2.0  # seconds that the other side may take for one step


def clean_zenoh_error(error: str) -> str:
    """Return zenoh's message on one line, without places in its source."""
    return " ".join(SOURCE_PLACE.sub("", error).split())[:MAX_ZENOH_ERROR].rstrip(".")


def unreachable_error(
    endpoints: Sequence[Endpoint], seconds: float, credentials: Credentials | None
) -> EndpointError:
    """Return the error for routers that do not answer, with the reason for each endpoint."""
    reasons = "; ".join(f"{endpoint.text}: {_failure(endpoint, credentials)}" for endpoint in endpoints)
    return EndpointError(
        f"Nothing answers within {seconds:g} s at {reasons}. Is the coordinator or router running there? "
        "Name another with --connect, or wait longer with --wait."
    )


def _failure(endpoint: Endpoint, credentials: Credentials | None) -> str:
    """Return why no session is opened, by one more try with nothing but a socket."""
    import ssl  # a worker that is welcome need not load it

    try:
        with socket.create_connection((endpoint.host, endpoint.port), HANDSHAKE_SECONDS) as plain:
            if credentials is not None:
                context = ssl.create_default_context(cafile=str(credentials.authority))
                context.load_cert_chain(credentials.certificate, credentials.key)
                with (
                    context.wrap_socket(plain, server_hostname=endpoint.host) as link,
                    suppress(TimeoutError),
                ):
                    link.recv(1)  # a router that does not take our certificate says so only now
    except ssl.SSLCertVerificationError as error:
        return f"the certificate it shows is not good ({error.verify_message})"
    except ssl.SSLError as error:
        return f"it does not take the files of {credentials} ({error.reason or error})"
    except OSError as error:
        return (error.strerror or str(error)).lower()
    return "something listens, but the link is slow, or it is no router of qdgrasp"
