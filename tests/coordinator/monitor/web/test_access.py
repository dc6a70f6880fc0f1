from socket import gethostname

import pytest
from tests.coordinator.monitor.web.conftest import client
from tests.coordinator.monitor.web.fakes import FakeFeed

from qdgrasp_coordinator.monitor.web.access import Access
from qdgrasp_protocol.errors import ImpossibleValue

COOKIE = "qdgrasp-monitor-8080"
TOKEN = "a-token-of-some-length"  # noqa: S105 - it opens nothing
LOCKED = Access(local=False, token=TOKEN)
PAGES = ("/", "/api/state", "/metrics", "/static/app.js", "/api/jobs/mug/curves", "/nowhere")


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1:8080", "[::1]:8080", "LOCALHOST:80", "127.8.0.1"])
def test_a_page_on_loopback_answers_to_the_names_of_this_machine(feed: FakeFeed, host: str) -> None:
    assert client(feed).get("/", headers={"host": host}).status_code == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8080", "192.168.0.7", "localhost.evil.example", "", "["]
)
def test_a_page_on_loopback_answers_to_no_other_name(feed: FakeFeed, host: str) -> None:
    for page in PAGES:
        assert client(feed).get(page, headers={"host": host}).status_code == 421


@pytest.mark.parametrize("method", ["POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "CONNECT"])
def test_nothing_can_be_written(feed: FakeFeed, method: str) -> None:
    for page in PAGES:
        answer = client(feed).request(method, page)
        assert (answer.status_code, answer.headers["allow"]) == (405, "GET, HEAD")


def test_without_the_token_nothing_is_seen_but_how_the_door_looks(feed: FakeFeed) -> None:
    strangers = client(feed, LOCKED)
    assert {strangers.get(page).status_code for page in PAGES} == {401}
    assert strangers.get("/static/style.css").status_code == 200
    assert strangers.get("/", headers={"accept": "text/html"}).text.count("<input") == 1


@pytest.mark.parametrize("wrong", ["", "a", TOKEN[:-1], TOKEN + "x", TOKEN.upper(), "töken"])
def test_another_token_opens_nothing(feed: FakeFeed, wrong: str) -> None:
    strangers = client(feed, LOCKED)
    assert (
        strangers.get("/api/state", headers={"authorization": f"Bearer {wrong}".encode()}).status_code == 401
    )
    assert strangers.get("/api/state", headers={"cookie": f"{COOKIE}={wrong}".encode()}).status_code == 401
    assert strangers.get("/", params={"token": wrong}).status_code == 401


def test_the_token_opens_the_page_in_a_header_or_a_cookie(feed: FakeFeed) -> None:
    guest = client(feed, LOCKED)
    assert guest.get("/metrics", headers={"authorization": f"Bearer {TOKEN}"}).status_code == 200
    assert guest.get("/metrics", headers={"cookie": f"other=1; {COOKIE}={TOKEN}"}).status_code == 200


def test_the_token_in_the_address_becomes_a_cookie_that_no_script_and_no_other_page_gets(
    feed: FakeFeed,
) -> None:
    guest = client(feed, LOCKED)
    entered = guest.get("/", params={"token": TOKEN})
    assert (entered.status_code, entered.headers["location"]) == (303, "/")
    cookie = entered.headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=lax" in cookie
    assert guest.get("/api/state").status_code == 200


def test_the_cookie_of_another_port_is_another(feed: FakeFeed) -> None:
    headers = {"cookie": f"{COOKIE}={TOKEN}", "host": "head:9090"}
    assert client(feed, LOCKED).get("/api/state", headers=headers).status_code == 401


def test_the_token_opens_a_page_elsewhere_under_any_name(feed: FakeFeed) -> None:
    for host in ("head.lab.example:8080", "head", "[2001:db8::1]", "head:port", ""):
        headers = {"authorization": f"Bearer {TOKEN}", "host": host}
        assert client(feed, LOCKED).get("/", headers=headers).status_code == 200


def test_a_token_can_be_asked_for_on_loopback_too(feed: FakeFeed) -> None:
    access = Access.at("127.0.0.1", TOKEN)
    assert client(feed, access).get("/api/state").status_code == 401
    headers = {"authorization": f"Bearer {TOKEN}", "host": "evil.example"}
    assert client(feed, access).get("/api/state", headers=headers).status_code == 421


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost"])
def test_on_loopback_there_is_no_token_unless_one_is_given(host: str) -> None:
    assert Access.at(host) == Access(local=True)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "head", "192.168.0.7"])  # noqa: S104
def test_elsewhere_there_is_always_a_token_and_each_time_another_one(host: str) -> None:
    made = {Access.at(host).token for _ in range(5)}
    assert len(made) == 5
    assert min(map(len, made)) >= 32


def test_a_short_token_is_refused_and_not_repeated() -> None:
    with pytest.raises(ImpossibleValue, match="at least 16 characters") as refusal:
        Access.at("127.0.0.1", "secret")
    assert "secret" not in str(refusal.value)


def test_the_address_says_where_the_page_is() -> None:
    assert Access.at("127.0.0.1").address("127.0.0.1", 8080) == "http://127.0.0.1:8080/"
    assert Access.at("::1").address("::1", 8080) == "http://[::1]:8080/"
    assert gethostname() in Access.at("::").address("::", 80)
    made = Access.at("head")
    assert made.address("head", 80) == f"http://head:80/?token={made.token}"


def test_a_token_that_somebody_chose_is_not_told() -> None:
    assert Access.at("head", TOKEN).address("head", 80) == "http://head:80/"


@pytest.mark.parametrize(
    "token", ["a-tóken-of-some-length", "令牌" * 10, "a token of some length", TOKEN + "\n"]
)
def test_a_token_that_no_header_can_hold_is_refused(token: str) -> None:
    with pytest.raises(ImpossibleValue, match="ASCII without spaces") as refusal:
        Access.at("head", token)
    assert token not in str(refusal.value)


def test_every_answer_has_the_headers_that_keep_a_browser_safe(feed: FakeFeed) -> None:
    for guest in (client(feed), client(feed, LOCKED)):
        for answer in (
            *map(guest.get, PAGES),
            guest.post("/"),
            guest.get("/", headers={"host": "evil.example"}),
        ):
            policy = answer.headers["content-security-policy"]
            assert "default-src 'none'" in policy
            assert "unsafe" not in policy
            assert answer.headers["x-content-type-options"] == "nosniff"
            assert answer.headers["referrer-policy"] == "no-referrer"
            assert "access-control-allow-origin" not in answer.headers
