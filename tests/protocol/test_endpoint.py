"""Endpoints, and who gets to them."""

import pytest
from structlog.testing import capture_logs

from qdgrasp_protocol.endpoint import Endpoint, check_open, home, parse_all
from qdgrasp_protocol.errors import EndpointError


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("tcp/127.0.0.1:7447", "127.0.0.1", 7447),
        ("tls/head.lab.example:1", "head.lab.example", 1),
        ("tls/[::1]:7447", "::1", 7447),
        ("quic/10.0.0.1:65535", "10.0.0.1", 65535),
        ("tcp/host:80#iface=eth0", "host", 80),
    ],
)
def test_an_endpoint_is_read_into_its_parts(text: str, host: str, port: int) -> None:
    found = Endpoint.parse(text)
    assert (found.text, found.host, found.port) == (text, host, port)


@pytest.mark.parametrize(
    "text", ["", "7447", "host:1", "tcp/host", "tcp/a b:1", "tpc/a:1", "tcp/a:65536", "tls/a:1,tls/b", ","]
)
def test_what_is_no_endpoint_is_refused_with_how_to_write_one(text: str) -> None:
    with pytest.raises(EndpointError, match="write it as tcp/HOST:PORT"):
        parse_all(text)


def test_several_are_separated_by_commas() -> None:
    assert [found.host for found in parse_all("tls/a:1,tls/b:2,tls/c:3")] == ["a", "b", "c"]


@pytest.mark.parametrize(
    "text", ["tcp/127.0.0.1:1", "tcp/127.8.8.8:1", "tcp/localhost:1", "tcp/[::1]:1", "unixsock-stream/tmp/a"]
)
def test_only_this_machine_gets_to_loopback(text: str) -> None:
    assert Endpoint.parse(text).is_local
    check_open(Endpoint.parse(text), insecure=False)


@pytest.mark.parametrize("text", ["tcp/0.0.0.0:1", "tcp/10.0.0.1:1", "tcp/head:1", "tcp/[::]:1", "ws/head:1"])
def test_where_strangers_get_to_nobody_listens_unless_it_is_meant(text: str) -> None:
    endpoint = Endpoint.parse(text)
    with pytest.raises(EndpointError, match=r"--security DIR .* add --insecure") as caught:
        check_open(endpoint, insecure=False)
    assert caught.value.exit_code == 2
    with capture_logs() as said:
        check_open(endpoint, insecure=True)
    assert [(line["log_level"], line["endpoint"]) for line in said] == [("warning", text)]


def test_encrypted_links_may_be_listened_on_anywhere() -> None:
    with capture_logs() as said:
        check_open(Endpoint.parse("tls/0.0.0.0:7447"), insecure=False)
    assert said == []


def test_the_default_is_on_loopback() -> None:
    assert home(encrypted=False).text == "tcp/127.0.0.1:7447"
    assert home(encrypted=True).text == "tls/127.0.0.1:7447"
    assert home(encrypted=True).is_local


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
    assert Endpoint.parse(text).from_here == near
