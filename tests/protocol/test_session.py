"""Endpoints, and the machines that can reach them."""

import os
import re
import socket
from contextlib import nullcontext
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from qdgrasp_protocol.errors import EndpointError, SecurityError
from qdgrasp_protocol.session import (
    Credentials,
    Endpoint,
    Role,
    check_open,
    parse_endpoints,
    session_settings,
)


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("tcp/127.0.0.1:7447", "127.0.0.1", 7447),
        ("tls/head.lab.example:1", "head.lab.example", 1),
        ("tls/[::1]:7447", "::1", 7447),
        ("tcp/host:80#iface=eth0", "host", 80),
    ],
)
def test_an_endpoint_is_read_into_its_parts(text: str, host: str, port: int) -> None:
    found = Endpoint.parse(text)
    assert (found.text, found.host, found.port) == (text, host, port)


@pytest.mark.parametrize(
    "text",
    [
        "", "7447", "host:1", "tcp/host", "tcp/a b:1", "tpc/a:1", "tcp/a:65536", "tls/a:1,tls/b", ",",
        "tcp/head..lab:7447", "tcp/.head:7447", f"tcp/{'a' * 64}.lab:7447",
    ],
)  # fmt: skip
def test_what_is_no_endpoint_is_refused_with_how_to_write_one(text: str) -> None:
    with pytest.raises(EndpointError, match="write it as tcp/HOST:PORT"):
        parse_endpoints(text)


@pytest.mark.parametrize(
    "text", ["tcp/127.0.0.1:1", "tcp/127.8.8.8:1", "tcp/localhost:1", "tcp/[::1]:1", "unixsock-stream/tmp/a"]
)
def test_only_this_machine_gets_to_loopback(text: str) -> None:
    assert Endpoint.parse(text).is_local
    check_open(Endpoint.parse(text), insecure=False)


@pytest.mark.parametrize("text", ["tcp/0.0.0.0:1", "tcp/10.0.0.1:1", "tcp/head:1", "tcp/[::]:1"])
def test_where_strangers_get_to_nobody_listens_unless_it_is_meant(text: str) -> None:
    endpoint = Endpoint.parse(text)
    with pytest.raises(EndpointError, match=r"--security DIR .* add --insecure") as caught:
        check_open(endpoint, insecure=False)
    assert caught.value.exit_code == 2
    assert f"listen on tls/{text.partition('/')[2]} with" in str(caught.value)
    with capture_logs() as said:
        check_open(endpoint, insecure=True)
    assert [(line["log_level"], line["endpoint"]) for line in said] == [("warning", text)]


@pytest.mark.parametrize(
    ("text", "near"),
    [
        ("tls/0.0.0.0:7000", "tls/127.0.0.1:7000"),
        ("tcp/[::]:7000", "tcp/[::1]:7000"),
        ("tls/10.0.0.1:7000", "tls/10.0.0.1:7000"),
        ("tls/head:7000", "tls/head:7000"),
        ("unixsock-stream//run/qdgrasp", "unixsock-stream//run/qdgrasp"),
    ],
)
def test_who_listens_everywhere_is_found_on_loopback(text: str, near: str) -> None:
    assert Endpoint.parse(text).reached_from(here=True) == near
    far = re.sub(r"(127\.0\.0\.1|\[::1\]):7000", f"{socket.gethostname()}:7000", near)
    assert Endpoint.parse(text).reached_from(here=False) == far


WORKER = Credentials(Path("/etc/qdgrasp"), Role.WORKER)
ROUTER = Credentials(Path("/etc/qdgrasp"), Role.ROUTER)


@pytest.mark.parametrize(
    ("connect", "credentials", "words"),
    [
        ("tls/head:7447", None, "needs certificates: name their folder with --security"),
        ("tls/a:1,tcp/b:1", WORKER, "is not encrypted"),
    ],
)
def test_encrypted_endpoints_need_certificates_which_are_not_left_unused(connect, credentials, words) -> None:
    with pytest.raises(EndpointError, match=words):
        session_settings("client", connect=parse_endpoints(connect), credentials=credentials)


def filled(folder: Path, role: Role = Role.WORKER) -> Path:
    for name in ("ca.pem", f"{role}.pem", f"{role}.key", f"{role}.json5"):
        (folder / name).touch(0o600)
    return folder


@pytest.mark.parametrize("name", ["ca.pem", "worker.pem", "worker.key", "router.json5"])
def test_a_missing_file_is_named(tmp_path: Path, name: str) -> None:
    role = Role.ROUTER if name == "router.json5" else Role.WORKER  # which needs no access list
    (filled(tmp_path, role) / name).unlink()
    with pytest.raises(SecurityError, match=f"lacks {name}, which the {role} needs") as caught:
        Credentials.find(tmp_path, role)
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
def test_a_group_may_read_what_root_hands_to_it(tmp_path, monkeypatch, mode, is_taken) -> None:
    (filled(tmp_path) / "worker.key").chmod(mode)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with nullcontext() if is_taken else pytest.raises(SecurityError):
        Credentials.find(tmp_path, Role.WORKER)
