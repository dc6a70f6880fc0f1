from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import pytest
from tests.common import own_endpoint

from qdgrasp_protocol.session import Credentials, Role
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools import security as security_folder
from qdgrasp_tools.security import CertificateIdentity, SecurityFolder, write_private_file

HOSTS = ("localhost", "127.0.0.1")


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that `qdgrasp security init` wrote."""
    return SecurityFolder.create(tmp_path_factory.mktemp("home") / "security", hosts=HOSTS, days=2).path


def encrypted_endpoint() -> str:
    """One on a port that is free now."""
    return own_endpoint("tls")


def certificate_files(
    place: Path,
    signer: CertificateIdentity,
    common_name: str = Role.WORKER.common_name,
    trusts: CertificateIdentity | None = None,
    now: datetime | None = None,
) -> Credentials:
    """Issue a certificate for a day from `now` that trusts routers of `trusts`, else of its signer."""
    place.mkdir()
    files = Credentials(place, Role.WORKER)
    identity = security_folder.issue_certificate(signer, common_name, 1, now=now)
    write_private_file(files.authority, (trusts or signer).certificate_pem)
    write_private_file(files.certificate, identity.certificate_pem)
    write_private_file(files.key, identity.key_pem)
    return files


@pytest.fixture(scope="session")
def secured(folder: Path) -> Iterator[str]:
    """The endpoint of a router with the access list."""
    endpoint = encrypted_endpoint()
    with ZenohBus.router(endpoint, credentials=Credentials.find(folder, Role.ROUTER)):
        yield endpoint
