"""The one builder of sessions."""

import json
import os
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest
import zenoh

from qdgrasp_protocol.credentials import Credentials, Role
from qdgrasp_protocol.endpoint import parse_all
from qdgrasp_protocol.errors import EndpointError, SecurityError
from qdgrasp_protocol.session import SETTINGS, nested, settings, to_json5

NOBODY = 65534
WORKER = Credentials(Path("/etc/qdgrasp"), Role.WORKER)
ROUTER = Credentials(Path("/etc/qdgrasp"), Role.ROUTER)


def test_every_setting_is_one_of_zenohs() -> None:
    config = zenoh.Config()
    chosen = settings("router", listen=parse_all("tls/a:1"), connect=parse_all("tls/b:1"), credentials=ROUTER)
    for name, value in chosen.items():
        config.insert_json5(name, json.dumps(value))
        assert json.loads(config.get_json(name)) == value


def test_a_configuration_file_holds_the_same_settings() -> None:
    chosen = settings("client", connect=parse_all("tls/a:1,tls/b:2"), credentials=WORKER, seconds=1.5)
    config = zenoh.Config.from_json5(to_json5(chosen, "two\nlines"))
    for name, value in chosen.items():
        assert json.loads(config.get_json(name)) == value


def test_nobody_is_scouted_and_memory_is_not_shared() -> None:
    for mode in ("client", "router"):
        assert SETTINGS.items() <= settings(mode).items()
    assert SETTINGS["scouting/multicast/enabled"] is False
    assert SETTINGS["transport/shared_memory/enabled"] is False


def test_both_sides_show_certificates_and_names_are_verified() -> None:
    for mode, credentials in (("client", WORKER), ("router", ROUTER)):
        tls = nested(settings(mode, credentials=credentials))["transport"]["link"]["tls"]
        assert tls["enable_mtls"] is tls["verify_name_on_connect"] is tls["close_link_on_expiration"] is True
        assert tls["root_ca_certificate"] == "/etc/qdgrasp/ca.pem"
        assert tls["connect_private_key"] == f"/etc/qdgrasp/{credentials.role}.key"
        assert ("listen_certificate" in tls) == (mode == "router")


def test_an_encrypted_endpoint_needs_certificates() -> None:
    with pytest.raises(EndpointError, match="needs certificates: name their folder with --security"):
        settings("client", connect=parse_all("tls/head:7447"))


def test_certificates_are_not_left_unused() -> None:
    with pytest.raises(EndpointError, match="is not encrypted"):
        settings("client", connect=parse_all("tls/a:1,tcp/b:1"), credentials=WORKER)


def filled(folder: Path, role: Role = Role.WORKER) -> Path:
    for name in ("ca.pem", f"{role}.pem", f"{role}.key", f"{role}.json5"):
        (folder / name).touch(0o600)
    return folder


def test_without_a_folder_there_are_no_credentials() -> None:
    assert Credentials.find(None, Role.WORKER) is None


@pytest.mark.parametrize("name", ["ca.pem", "worker.pem", "worker.key"])
def test_a_missing_file_is_named(tmp_path: Path, name: str) -> None:
    (filled(tmp_path) / name).unlink()
    with pytest.raises(SecurityError, match=f"lacks {name}, which the worker needs") as caught:
        Credentials.find(tmp_path, Role.WORKER)
    assert caught.value.exit_code == 2


def test_a_router_needs_its_access_list(tmp_path: Path) -> None:
    (filled(tmp_path, Role.ROUTER) / "router.json5").unlink()
    with pytest.raises(SecurityError, match=r"lacks router\.json5"):
        Credentials.find(tmp_path, Role.ROUTER)


@pytest.fixture
def nobody() -> Iterator[None]:
    """Whoever runs the tests, without the rights of root."""
    user = os.geteuid()
    if user == 0:
        os.seteuid(NOBODY)
    yield
    os.seteuid(user)


def test_a_folder_of_another_user_is_one_sentence(tmp_path: Path, nobody: None) -> None:
    folder = tmp_path / "theirs"
    if os.geteuid() != NOBODY:
        folder.mkdir(0)
    with pytest.raises(SecurityError, match=r"cannot be read \(Permission denied\)") as caught:
        Credentials.find(folder, Role.WORKER)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("mode", [0o640, 0o620, 0o604, 0o666])
def test_a_key_that_others_can_read_is_refused(tmp_path: Path, mode: int) -> None:
    (filled(tmp_path) / "worker.key").chmod(0o400)
    Credentials.find(tmp_path, Role.WORKER)
    (tmp_path / "worker.key").chmod(mode)
    with pytest.raises(SecurityError, match="chmod 600"):
        Credentials.find(tmp_path, Role.WORKER)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can hand its files over")
@pytest.mark.parametrize(("mode", "is_taken"), [(0o440, True), (0o460, False), (0o444, False)])
def test_a_group_may_read_what_root_hands_to_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: int, is_taken: bool
) -> None:
    (filled(tmp_path) / "worker.key").chmod(mode)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with nullcontext() if is_taken else pytest.raises(SecurityError):
        Credentials.find(tmp_path, Role.WORKER)
