"""Access to the page: open on this machine, with a token from elsewhere."""

import hmac
import re
import secrets
from collections.abc import Iterable
from dataclasses import dataclass
from ipaddress import ip_address
from socket import gethostname
from urllib.parse import quote, urlsplit

from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from qdgrasp_protocol.errors import ImpossibleValue

COOKIE = "qdgrasp-monitor"
MIN_TOKEN_LENGTH = 16  # The fewest characters of a token that the user chose
PRINTABLE = re.compile(r"[!-~]+")
CHARACTERS = "characters of ASCII without spaces"
READING = ("GET", "HEAD")
PUBLIC_PATHS = ("/static/style.css",)  # Files of the page that asks for the token
WILDCARD_HOSTS = ("", "::", "0.0.0.0")  # noqa: S104  # it is only compared with
SECURITY_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
"""Headers of every answer: nothing is loaded from elsewhere, and no page embeds this one."""
LOGIN_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>qdgrasp: token</title><link rel="stylesheet" href="/static/style.css">
<body class="token-page"><main><h1>qdgrasp</h1><form method="get" action="/">
<label for="token">Token that was printed with the address</label>
<input id="token" name="token" type="password" autocomplete="current-password" required autofocus>
<button>Open</button></form></main></body></html>
"""


@dataclass(frozen=True)
class Access:
    """Rules for the requests to a page."""

    local: bool
    """True on loopback: only requests under a name of this machine are answered.

    Otherwise a page elsewhere could read it through a name that resolves to this machine (DNS rebinding).
    """
    token: str = ""  # Token that a request must have; empty: none
    is_generated: bool = False  # True for a new token, which the user must be told

    @classmethod
    def at(cls, host: str, token: str = "") -> "Access":
        """Return the rules of a page served at `host`: beyond loopback there is always a token.

        One that is too short, or of characters that no header may have, raises `ImpossibleValue`.
        """
        if token and (len(token) < MIN_TOKEN_LENGTH or not PRINTABLE.fullmatch(token)):
            raise ImpossibleValue("the token", "*" * len(token), f"at least {MIN_TOKEN_LENGTH} {CHARACTERS}")
        is_generated = not (token or is_loopback(host))
        return cls(is_loopback(host), secrets.token_urlsafe(24) if is_generated else token, is_generated)

    def address(self, host: str, port: int) -> str:
        """Return the address for a browser, with the token where it is a new one."""
        named = gethostname() if host in WILDCARD_HOSTS else f"[{host}]" if ":" in host else host
        return f"http://{named}:{port}/" + (f"?token={quote(self.token)}" if self.is_generated else "")

    def refusal(self, request: Request) -> Response | None:
        """Return the answer to a request that is refused; None where it is allowed."""
        if {"content-length", "transfer-encoding"} <= {*request.headers}:
            # where each ends is a matter of opinion, and a proxy may have another (RFC 9112, 6.3)
            reason = "A request may say the length of its body, or send it in chunks, not both.\n"
            return PlainTextResponse(reason, 400, {"Connection": "close"})
        if request.method not in READING:
            return PlainTextResponse("This page is read only.\n", 405, {"Allow": ", ".join(READING)})
        if self.local and not is_loopback(_hostname(request.headers.get("host", ""))):
            return PlainTextResponse("This page is served under the name localhost only.\n", 421)
        if not self.token or request.url.path in PUBLIC_PATHS or self._is_valid(_tokens_of(request)):
            return None
        if request.url.path == "/" and self._is_valid([request.query_params.get("token", "")]):
            entered = RedirectResponse("/", 303)
            entered.set_cookie(_cookie_name(request), self.token, httponly=True, samesite="lax")
            return entered
        headers = {"WWW-Authenticate": "Bearer", "Cache-Control": "no-store"}
        asks = "text/html" in request.headers.get("accept", "") and request.url.path == "/"
        kind = "text/html" if asks else "text/plain"
        return Response(LOGIN_PAGE if asks else "A token is needed.\n", 401, headers, kind)

    def _is_valid(self, tokens: Iterable[str]) -> bool:
        """Return whether the token is among these; the time that this takes tells nothing about it."""
        return any(hmac.compare_digest(each.encode(), self.token.encode()) for each in tokens)


def guard(app: ASGIApp, access: Access) -> ASGIApp:
    """Make an application refuse requests by the rules, and add the security headers."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.update(SECURITY_HEADERS)
                headers.setdefault("Cache-Control", "no-cache")
            await send(message)

        response = access.refusal(Request(scope)) or app
        await response(scope, receive, send_guarded)

    return answer


def is_loopback(host: str) -> bool:
    """Return whether a name or address can only be this machine."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def _hostname(host: str) -> str:
    """Return the name in a Host header, without its port; empty where it is not valid."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _tokens_of(request: Request) -> list[str]:
    scheme, _, word = request.headers.get("authorization", "").partition(" ")
    bearer = word.strip() if scheme.lower() == "bearer" else ""
    return [bearer, request.cookies.get(_cookie_name(request), "")]


def _cookie_name(request: Request) -> str:
    """Return the name of a page's cookie: each port of a machine has its own."""
    port = request.headers.get("host", "").rpartition(":")[2]
    return f"{COOKIE}-{port}" if port.isdecimal() else COOKIE
