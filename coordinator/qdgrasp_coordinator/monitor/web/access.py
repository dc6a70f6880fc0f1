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
MIN_TOKEN_LENGTH = 16  # The fewest characters of a token that somebody chose
PRINTABLE = re.compile(r"[!-~]+")
CHARACTERS = "characters of ASCII without spaces"
READING = ("GET", "HEAD")
PUBLIC_PATHS = ("/static/style.css",)  # What the page that asks for the token is drawn with
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
"""Headers of every answer: nothing comes from elsewhere, and nothing elsewhere holds this page."""
LOGIN_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>qdgrasp: token</title><link rel="stylesheet" href="/static/style.css">
<body class="door"><main><h1>qdgrasp</h1><form method="get" action="/">
<label for="token">Token that was printed with the address</label>
<input id="token" name="token" type="password" autocomplete="current-password" required autofocus>
<button>Open</button></form></main></body></html>
"""


@dataclass(frozen=True)
class Access:
    """Who may see the page.

    Parameters
    ----------
    local
        Whether it is served on loopback only. A page elsewhere that names this machine by a name of its own
        is then refused by the name it asks for (DNS rebinding).
    token
        What has to be shown; empty: nothing.
    is_made
        Whether nobody chose the token, so that it has to be told.
    """

    local: bool
    token: str = ""
    is_made: bool = False

    @classmethod
    def at(cls, host: str, token: str = "") -> "Access":
        """That of a page served at `host`: beyond loopback there is always a token, if need be a new one.

        Raises
        ------
        ImpossibleValue
            The token is too short to keep anybody out, or of characters that no header may have.
        """
        if token and (len(token) < MIN_TOKEN_LENGTH or not PRINTABLE.fullmatch(token)):
            raise ImpossibleValue("the token", "*" * len(token), f"at least {MIN_TOKEN_LENGTH} {CHARACTERS}")
        local = is_loopback(host)
        return cls(local, token or ("" if local else secrets.token_urlsafe(24)), is_made=not (token or local))

    def address(self, host: str, port: int) -> str:
        """Where a browser opens the page, with the token where one was made for it."""
        named = gethostname() if host in WILDCARD_HOSTS else f"[{host}]" if ":" in host else host
        return f"http://{named}:{port}/" + (f"?token={quote(self.token)}" if self.is_made else "")

    def refusal(self, request: Request) -> Response | None:
        """The answer to somebody who may not see it; None to whoever may."""
        if request.method not in READING:
            return PlainTextResponse("This page is read only.\n", 405, {"Allow": ", ".join(READING)})
        if self.local and not is_loopback(_hostname(request.headers.get("host", ""))):
            return PlainTextResponse("This page is served under the name localhost only.\n", 421)
        if not self.token or request.url.path in PUBLIC_PATHS or self._is_shown(_tokens_of(request)):
            return None
        return self._door(request)

    def _door(self, request: Request) -> Response:
        """Let somebody in who has the token in the address, and ask others for it."""
        if request.url.path == "/" and self._is_shown([request.query_params.get("token", "")]):
            entered = RedirectResponse("/", 303)
            entered.set_cookie(_cookie_name(request), self.token, httponly=True, samesite="lax")
            return entered
        headers = {"WWW-Authenticate": "Bearer", "Cache-Control": "no-store"}
        asks = "text/html" in request.headers.get("accept", "") and request.url.path == "/"
        kind = "text/html" if asks else "text/plain"
        return Response(LOGIN_PAGE if asks else "A token is needed.\n", 401, headers, kind)

    def _is_shown(self, shown: Iterable[str]) -> bool:
        """Whether the token is among what was shown; how long this takes says nothing about it."""
        return any(hmac.compare_digest(each.encode(), self.token.encode()) for each in shown)


class AccessMiddleware:
    """Hands on what may be seen, and gives every answer the headers that keep a browser safe."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            return

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.update(SECURITY_HEADERS)
                headers.setdefault("Cache-Control", "no-cache")
            await send(message)

        answer = self._access.refusal(Request(scope)) or self._app
        await answer(scope, receive, guarded)


def is_loopback(host: str) -> bool:
    """Whether a name or address can only be this machine."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def _hostname(host: str) -> str:
    """The name in a Host header, without its port; empty where it is none."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _tokens_of(request: Request) -> list[str]:
    """The tokens that come with a request."""
    scheme, _, word = request.headers.get("authorization", "").partition(" ")
    bearer = word.strip() if scheme.lower() == "bearer" else ""
    return [bearer, request.cookies.get(_cookie_name(request), "")]


def _cookie_name(request: Request) -> str:
    """The cookie of a page: those of other ports of the same machine are others."""
    port = request.headers.get("host", "").rpartition(":")[2]
    return f"{COOKIE}-{port}" if port.isdecimal() else COOKIE
