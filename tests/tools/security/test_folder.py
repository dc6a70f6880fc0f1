"""Folders that `qdgrasp security init` and `add` write."""

import os
import stat
from pathlib import Path

import pytest
from cryptography import x509

from qdgrasp_protocol.errors import ImpossibleValue, OutputError, SecurityError
from qdgrasp_protocol.session import Credentials, Role
from qdgrasp_tools.security import SecurityFolder

HOSTS = ["head", "10.0.0.1", "::1"]


@pytest.fixture
def made(tmp_path: Path) -> SecurityFolder:
    return SecurityFolder.create(tmp_path / "security", hosts=HOSTS, days=30)


def certificate(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(path.read_bytes())


def test_only_the_owner_can_read_what_is_written(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        folder = SecurityFolder.create(tmp_path / "security", hosts=HOSTS, days=30)
        added = folder.add(Role.WORKER, "lab-7", hosts=HOSTS, days=1)
    finally:
        os.umask(before)
    for place in (folder.path, added):
        assert stat.S_IMODE(place.stat().st_mode) == 0o700
        files = [path for path in place.iterdir() if path.is_file()]
        assert {stat.S_IMODE(path.stat().st_mode) for path in files} == {0o600}


def test_certificates_name_their_role_and_only_routers_serve(made: SecurityFolder) -> None:
    for role in Role:
        found = certificate(made.path / f"{role}.pem")
        names = found.subject.get_attributes_for_oid(x509.NameOID.COMMON_NAME)
        uses = found.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        assert [name.value for name in names] == [f"qdgrasp-{role}"]
        assert x509.ExtendedKeyUsageOID.CLIENT_AUTH in uses
        assert (x509.ExtendedKeyUsageOID.SERVER_AUTH in uses) == (role is Role.ROUTER)
        assert not found.extensions.get_extension_for_class(x509.BasicConstraints).value.ca


def test_a_router_is_known_by_the_names_and_addresses_given(made: SecurityFolder) -> None:
    found = certificate(made.path / "router.pem")
    names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["head"]
    assert [str(a) for a in names.get_values_for_type(x509.IPAddress)] == ["10.0.0.1", "::1"]


def test_nothing_is_overwritten(made: SecurityFolder) -> None:
    before = {path.name: path.read_bytes() for path in made.path.iterdir()}
    with pytest.raises(OutputError, match="or add to it with `qdgrasp security add"):
        SecurityFolder.create(made.path, hosts=HOSTS, days=30)
    made.add(Role.WORKER, "lab-7", hosts=HOSTS, days=1)
    with pytest.raises(OutputError, match="choose another name"):
        made.add(Role.WORKER, "lab-7", hosts=HOSTS, days=1)
    assert {path.name: path.read_bytes() for path in made.path.iterdir() if path.is_file()} == before


def test_a_folder_for_one_node_holds_what_it_needs_and_nothing_else(made: SecurityFolder) -> None:
    place = made.add(Role.WORKER, "lab-7", hosts=HOSTS, days=1)
    assert {path.name for path in place.iterdir()} == {"ca.pem", "worker.pem", "worker.key"}
    assert certificate(place / "worker.pem").subject.rfc4514_string() == "OU=lab-7,CN=qdgrasp-worker"
    Credentials(place, Role.WORKER).check()


def test_further_certificates_need_the_authoritys_key(made: SecurityFolder) -> None:
    (made.path / "ca.key").unlink()
    with pytest.raises(SecurityError, match=r"ca\.key cannot be read"):
        made.add(Role.WORKER, "lab-7", hosts=HOSTS, days=1)
    (made.path / "ca.key").write_text("no key")
    with pytest.raises(SecurityError, match="cannot be read"):
        made.add(Role.WORKER, "lab-7", hosts=HOSTS, days=1)


@pytest.mark.parametrize("host", ["", "a b", "head:7447", "tls/head", "-head", "*"])
def test_what_is_no_host_is_refused_before_anything_is_written(tmp_path: Path, host: str) -> None:
    with pytest.raises(ImpossibleValue, match="--host"):
        SecurityFolder.create(tmp_path / "security", hosts=[host], days=1)
    assert not (tmp_path / "security").exists()
