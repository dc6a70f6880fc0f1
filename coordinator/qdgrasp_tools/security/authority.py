"""A certificate authority of one's own, and the certificates it issues."""

import ipaddress
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from qdgrasp_protocol.errors import SecurityError

Key = ec.EllipticCurvePrivateKey
AUTHORITY = "qdgrasp authority"
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
        if not isinstance(private, ec.EllipticCurvePrivateKey):
            raise SecurityError(
                "The authority's key is not an elliptic curve's, as `security init` writes it."
            )
        return cls(public, private)


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
        return x509.DNSName(host)
