"""Certificates of roles, and their access lists (docs/security.md).

The table of traffic says which role gives and takes which kind of message. The configuration of routers, for
`zenohd` and `qdgrasp-router`, follows from it, with access list and size limits.
"""

import ipaddress
import os
import re
from collections.abc import Iterable, Iterator, Sequence, Set
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from pathlib import Path
from typing import Any, cast

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from qdgrasp_coordinator.storage.outputs import OutFolder
from qdgrasp_protocol import session
from qdgrasp_protocol.errors import ImpossibleValue, SecurityError
from qdgrasp_protocol.keys import NAME, AnyJob, matches
from qdgrasp_protocol.messages import MAX_PAYLOAD
from qdgrasp_protocol.session import PORT, Credentials, Endpoint, Role, session_settings

JOBS = AnyJob()
KIB, MIB = 1 << 10, 1 << 20
COORDINATOR, RECORDER, WORKER = Role.COORDINATOR, Role.RECORDER, Role.WORKER
MONITORING = frozenset({Role.MONITOR, Role.ADMIN})


class TrafficKind(StrEnum):
    """The kind of exchange on a key."""

    PUT = "put"  # One side publishes, the other subscribes
    QUERY = "query"  # One side asks, the other answers
    TOKEN = "token"  # noqa: S105  # One side is alive, the other watches


PUT, QUERY, TOKEN = TrafficKind


@dataclass(frozen=True)
class Traffic:
    """One kind of traffic."""

    kind: TrafficKind
    key: str  # A pattern over the keys of all jobs
    givers: Set[Role]  # Roles that publish, ask, or are alive
    takers: Set[Role]  # Roles that subscribe, answer, or watch
    limit: int = 0  # The most bytes of a message or question
    answer_limit: int = 0  # The most bytes of an answer


TRAFFIC = (
    Traffic(PUT, JOBS.work("*"), {COORDINATOR}, {WORKER}, 4 * MIB),
    Traffic(PUT, JOBS.ctl("*"), {COORDINATOR}, {WORKER}, 256 * KIB),
    Traffic(PUT, JOBS.result(), {WORKER}, {COORDINATOR}, MAX_PAYLOAD),
    Traffic(PUT, JOBS.outcome(), {COORDINATOR}, {RECORDER}, 8 * MIB),
    Traffic(PUT, JOBS.recorded, {RECORDER}, {COORDINATOR}, 4 * KIB),
    Traffic(PUT, JOBS.stat("worker/*"), {WORKER}, {COORDINATOR}, 64 * KIB),
    Traffic(PUT, JOBS.stat("job"), {COORDINATOR}, set(), 256 * KIB),
    Traffic(PUT, JOBS.stat("run/*"), {COORDINATOR}, set(), 256 * KIB),
    Traffic(PUT, JOBS.stat("team/*"), {COORDINATOR}, set(), 256 * KIB),
    Traffic(PUT, JOBS.stat(), set(), MONITORING, 256 * KIB),
    Traffic(PUT, JOBS.meta, {COORDINATOR}, MONITORING, 256 * KIB),
    Traffic(PUT, JOBS.event(), {COORDINATOR}, MONITORING, 16 * KIB),
    Traffic(QUERY, JOBS.stat(), MONITORING, {COORDINATOR}, 4 * KIB, MIB),
    Traffic(QUERY, JOBS.meta, MONITORING, {COORDINATOR}, 4 * KIB, MIB),
    Traffic(QUERY, JOBS.recent, MONITORING, {COORDINATOR}, 4 * KIB, MIB),
    Traffic(QUERY, JOBS.entries, MONITORING, {RECORDER}, 4 * KIB, MIB),
    Traffic(QUERY, JOBS.objects, MONITORING, {RECORDER}, 4 * KIB, MIB),
    Traffic(QUERY, JOBS.finds, MONITORING, {RECORDER}, 4 * KIB, 2 * MIB),
    Traffic(QUERY, JOBS.recorded_asset(), MONITORING, {RECORDER}, 4 * KIB, MIB),
    Traffic(QUERY, JOBS.join, {WORKER}, {COORDINATOR}, 256 * KIB, 256 * KIB),
    Traffic(QUERY, JOBS.control, {Role.ADMIN}, {COORDINATOR}, 4 * KIB, 16 * KIB),
    Traffic(QUERY, JOBS.asset(), {WORKER, RECORDER}, {COORDINATOR}, 4 * KIB, MIB),
    Traffic(QUERY, JOBS.open, {COORDINATOR}, {RECORDER}, MAX_PAYLOAD, 256 * KIB),
    Traffic(QUERY, JOBS.log, {COORDINATOR}, {RECORDER}, 4 * KIB, 8 * MIB),
    Traffic(TOKEN, JOBS.coordinator_token(), {COORDINATOR}, {COORDINATOR, WORKER, Role.MONITOR}),
    Traffic(TOKEN, JOBS.worker_token(), {WORKER}, {COORDINATOR, Role.MONITOR}),
    Traffic(TOKEN, JOBS.recorder_token(), {RECORDER}, {COORDINATOR, Role.MONITOR}),
)
"""All traffic (docs/bus.md, keys)."""
GIVEN = {PUT: ["put"], QUERY: ["query"], TOKEN: ["liveliness_token"]}
"""Zenoh messages of the giving side: ingress from it, egress to the takers."""
TAKEN = {
    PUT: ["declare_subscriber"],
    QUERY: ["declare_queryable", "reply"],
    TOKEN: ["declare_liveliness_subscriber", "liveliness_query"],
}
"""Zenoh messages of the taking side: ingress from it, egress to the givers."""


def access_list() -> session.ZenohSettings:
    """Return the access list and the size limits of a router's configuration."""
    rules = {role: list(_rules(role)) for role in Role}
    return {
        "access_control": {
            "enabled": True,
            "default_permission": "deny",
            "rules": [rule for of_role in rules.values() for rule in of_role],
            "subjects": [{"id": role.value, "cert_common_names": [role.common_name]} for role in Role],
            "policies": [
                {"rules": [rule["id"] for rule in of_role], "subjects": [role.value]}
                for role, of_role in rules.items()
            ],
        },
        "low_pass_filter": [limit for flow in TRAFFIC for limit in _limits(flow)],
    }


def _rules(role: Role) -> Iterator[dict[str, Any]]:
    """Yield the rules of one role: what it sends, and what it gets from the other side."""
    for kind in TrafficKind:
        flows = [flow for flow in TRAFFIC if flow.kind is kind]
        if role is Role.ROUTER:  # a router takes from another one all that this lets in
            both, keys = ["ingress", "egress"], [flow.key for flow in flows]
            yield _rule(f"{role} relays ({kind})", GIVEN[kind] + TAKEN[kind], both, keys)
            continue
        given = [flow.key for flow in flows if role in flow.givers]
        taken = [flow.key for flow in flows if role in flow.takers]
        heard = [flow.key for flow in flows if flow.takers]
        takers = [key for key in heard if any(matches(key, each) for each in given)]
        sides = (
            ("gives", GIVEN[kind], "ingress", given),
            ("is taken from", TAKEN[kind], "egress", takers),
            ("takes", TAKEN[kind], "ingress", taken),
            ("is given", GIVEN[kind], "egress", taken),
        )
        for side, messages, direction, keys in sides:
            if keys:
                yield _rule(f"{role} {side} ({kind})", messages, [direction], keys)


def _rule(name: str, messages: list[str], directions: list[str], keys: list[str]) -> dict[str, Any]:
    return {
        "id": name,
        "messages": messages,
        "flows": directions,
        "permission": "allow",
        "key_exprs": list(dict.fromkeys(keys)),
    }


def _limits(flow: Traffic) -> list[dict[str, Any]]:
    sizes = {GIVEN[flow.kind][0]: flow.limit, "reply": flow.answer_limit}
    return [
        {
            "id": f"{message} {flow.key}",
            "messages": [message],
            "flows": ["ingress", "egress"],
            "key_exprs": [flow.key],
            "size_limit": size,
        }
        for message, size in sizes.items()
        if size
    ]


LISTEN_EVERYWHERE = "0.0.0.0"  # noqa: S104  # links are encrypted, and both sides show certificates
ROUTER_TEMPLATE = """\
A router of qdgrasp: `zenohd -c router.json5` or `qdgrasp-router --security DIR` reads it.
Written by `qdgrasp security init`: mutual TLS, and whatever is not allowed here is denied.
"""


def router_configuration(credentials: Credentials) -> str:
    """Return the configuration file of a router."""
    here = Endpoint.parse(f"tls/{LISTEN_EVERYWHERE}:{PORT}")
    chosen = session_settings("router", listen=[here], credentials=credentials)
    return session.to_json5(chosen | access_list(), ROUTER_TEMPLATE)


Key = ec.EllipticCurvePrivateKey
AUTHORITY = "qdgrasp authority"
HOST = re.compile(r"[A-Za-z0-9][A-Za-z0-9.-]*")
CLOCK_SKEW = timedelta(hours=1)  # Certificates begin so long ago, for clocks that are slow


@dataclass(frozen=True)
class CertificateIdentity:
    """A certificate and its private key."""

    certificate: x509.Certificate
    key: Key

    @property
    def certificate_pem(self) -> bytes:
        """The certificate as PEM."""
        return self.certificate.public_bytes(serialization.Encoding.PEM)

    @property
    def key_pem(self) -> bytes:
        """The key as PEM (PKCS 8), not encrypted: who may read the file has it."""
        return self.key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )

    @classmethod
    def from_pem(cls, certificate: bytes, key: bytes) -> "CertificateIdentity":
        """Read both from PEM; raises SecurityError for other text or another kind of key."""
        try:
            private = serialization.load_pem_private_key(key, None)
            public = x509.load_pem_x509_certificate(certificate)
        except (ValueError, TypeError) as error:
            raise SecurityError(f"The authority's certificate or key cannot be read: {error}") from None
        return cls(public, cast(Key, private))  # as `security init` writes it


def create_authority(days: int, now: datetime | None = None) -> CertificateIdentity:
    """Make an authority that is good for `days`."""
    key = ec.generate_private_key(ec.SECP256R1())
    usage = x509.KeyUsage(
        digital_signature=False,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=True,
        crl_sign=True,
        encipher_only=False,
        decipher_only=False,
    )
    subject = _name(AUTHORITY)
    builder = (
        _builder(subject, subject, key, days, now or datetime.now(UTC))
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage, critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )
    return CertificateIdentity(builder.sign(key, hashes.SHA256()), key)


def issue_certificate(
    authority: CertificateIdentity,
    common_name: str,
    days: int,
    *,
    hosts: Iterable[str] = (),
    holder: str = "",
    now: datetime | None = None,
) -> CertificateIdentity:
    """Issue a certificate that is good for `days`.

    A role's `common_name` decides on its rights; `hosts` are names and addresses of the router that shows it;
    `holder` is its owner, for people: a node's name, for example.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    names = [_alternative(host) for host in hosts]
    uses = [ExtendedKeyUsageOID.CLIENT_AUTH, *([ExtendedKeyUsageOID.SERVER_AUTH] if names else [])]
    issuer = authority.certificate
    builder = (
        _builder(_name(common_name, holder), issuer.subject, key, days, now or datetime.now(UTC))
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(authority.key.public_key()), critical=False
        )
    )
    if names:
        builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    return CertificateIdentity(builder.sign(authority.key, hashes.SHA256()), key)


def _builder(
    subject: x509.Name, issuer: x509.Name, key: Key, days: int, now: datetime
) -> x509.CertificateBuilder:
    return x509.CertificateBuilder(
        issuer_name=issuer,
        subject_name=subject,
        public_key=key.public_key(),
        serial_number=x509.random_serial_number(),
        not_valid_before=now - CLOCK_SKEW,
        not_valid_after=now + timedelta(days=days),
    )


def _name(common_name: str, holder: str = "") -> x509.Name:
    parts = [x509.NameAttribute(NameOID.COMMON_NAME, common_name)]
    if holder:
        parts.append(x509.NameAttribute(NameOID.ORGANIZATIONAL_UNIT_NAME, holder))
    return x509.Name(parts)


def _alternative(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        if HOST.fullmatch(host):
            return x509.DNSName(host)
        raise ImpossibleValue("--host", host, "a host's name or address, without a port") from None


PRIVATE_FILE, PRIVATE_FOLDER = 0o600, 0o700
AUTHORITY_DAYS = 3650  # Longer than the certificates that it issues


class SecurityFolder:
    """Certificates and keys in a folder that only its owner can read."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def create(cls, path: Path, *, hosts: Sequence[str], days: int) -> "SecurityFolder":
        """Create an authority and a certificate for each role, all files or none.

        Routers are reached by `hosts`; certificates are good for `days`. Raises `ImpossibleValue` for what is
        no host, `OutputError` or `DiskFull` where something is at `path` already, or it cannot be written.
        """
        out = OutFolder(path, f"name another path, or add to it with `qdgrasp security add {path} ROLE NAME`")
        out.check()
        root = create_authority(max(days, AUTHORITY_DAYS))
        with out.writing() as made:
            _make_folder(made, root)
            write_private_file(made / "ca.key", root.key_pem)
            for role in Role:
                _issue(made, Credentials(path.absolute(), role), root, hosts, days)
        return cls(path)

    @property
    def authority(self) -> CertificateIdentity:
        """The authority; raises SecurityError if its files are missing or cannot be read."""
        try:
            files = [(self.path / name).read_bytes() for name in ("ca.pem", "ca.key")]
        except OSError as error:
            raise SecurityError(
                f"{error.filename} cannot be read ({error.strerror}); certificates are issued in the folder "
                "that `qdgrasp security init` wrote."
            ) from None
        return CertificateIdentity.from_pem(*files)

    def add(self, role: Role, name: str, *, hosts: Sequence[str], days: int) -> Path:
        """Issue one more certificate of a role, in a folder of its own that a node can be given.

        Raises `SecurityError` where no authority is here, `OutputError` or `DiskFull`
        where such a folder is there already, or cannot be written.
        """
        if not NAME.fullmatch(name):
            raise ImpossibleValue("the name", name, "1 to 64 of the characters a-z, 0-9, '_' and '-'")
        root, place = self.authority, self.path / name
        with OutFolder(place, "choose another name").writing() as made:
            _make_folder(made, root)
            _issue(made, Credentials(place.absolute(), role), root, hosts, days, name)
        return place


def _make_folder(made: Path, root: CertificateIdentity) -> None:
    """Make a folder that only its owner can look into, with the authority's certificate."""
    made.mkdir(PRIVATE_FOLDER)
    made.chmod(PRIVATE_FOLDER)  # against the umask
    write_private_file(made / "ca.pem", root.certificate_pem)


def _issue(
    made: Path,
    files: Credentials,
    root: CertificateIdentity,
    hosts: Sequence[str],
    days: int,
    holder: str = "",
) -> None:
    """Write certificate and key of a role, and the configuration of a router, into a folder."""
    names = hosts if files.role is Role.ROUTER else ()
    identity = issue_certificate(root, files.role.common_name, days, hosts=names, holder=holder)
    write_private_file(made / files.certificate.name, identity.certificate_pem)
    write_private_file(made / files.key.name, identity.key_pem)
    if files.role is Role.ROUTER:
        write_private_file(made / files.configuration.name, router_configuration(files).encode())


def write_private_file(path: Path, content: bytes) -> None:
    """Write a new file that only its owner can read from the start."""
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, PRIVATE_FILE), "wb") as file:
        file.write(content)
