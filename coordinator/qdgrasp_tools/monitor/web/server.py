"""HTTP server of a read-only page: open on this machine, with a token from elsewhere."""

import asyncio
import hmac
import re
import secrets
import socket
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import quote, urlsplit

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import BaseRoute, Mount
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from qdgrasp_protocol.errors import EndpointError, ImpossibleValue, InputError, QdgraspError
from qdgrasp_protocol.process import Stop

STATIC = Path(__file__).with_name("static")
CLOSING_SECONDS = 1  # Answers in progress may take so long when the server ends [s]
MAX_REQUESTS = 512  # Further ones at the same time are answered 503
COOKIE = "qdgrasp-monitor"
TOKEN = re.compile(r"[!-~]{16,}")
WILDCARD_HOSTS = ("", "::", "0.0.0.0")  # noqa: S104  # it is only compared with
SECURITY_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
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
    is_generated: bool = False  # True for a new token, which the user must see

    @classmethod
    def at(cls, host: str, token: str = "") -> "Access":
        """Return the rules of a page served at `host`: beyond loopback there is always a token.

        One that is too short, or of characters that no header may have, raises `ImpossibleValue`.
        """
        if token and not TOKEN.fullmatch(token):
            expected = "at least 16 characters of ASCII without spaces"
            raise ImpossibleValue("the token", "*" * len(token), expected)
        is_generated = not (token or is_loopback(host))
        return cls(is_loopback(host), secrets.token_urlsafe(24) if is_generated else token, is_generated)

    def address(self, host: str, port: int) -> str:
        """Return the address for a browser, with the token where it is a new one."""
        named = socket.gethostname() if host in WILDCARD_HOSTS else f"[{host}]" if ":" in host else host
        return f"http://{named}:{port}/" + (f"?token={quote(self.token)}" if self.is_generated else "")

    def refusal(self, request: Request) -> Response | None:
        """Return the answer to a request that is refused; None where it is allowed."""
        if request.method not in ("GET", "HEAD"):
            return PlainTextResponse("This page is read only.\n", 405, {"Allow": "GET, HEAD"})
        if self.local and not is_loopback(_hostname(request.headers.get("host", ""))):
            return PlainTextResponse("This page is served under the name localhost only.\n", 421)
        port = request.headers.get("host", "").rpartition(":")[2]  # one host's ports share its cookies
        cookie = f"{COOKIE}-{port}" if port.isdecimal() else COOKIE
        bearer = request.headers.get("authorization", "").removeprefix("Bearer ")
        if not self.token or request.url.path == "/static/style.css":
            return None
        if self._is_valid(bearer) or self._is_valid(request.cookies.get(cookie, "")):
            return None
        is_page = request.url.path == "/"
        if is_page and self._is_valid(request.query_params.get("token", "")):
            entered = RedirectResponse("/", 303)
            entered.set_cookie(cookie, self.token, httponly=True, samesite="lax")
            return entered
        headers = {"WWW-Authenticate": "Bearer", "Cache-Control": "no-store"}
        wants_page = is_page and "text/html" in request.headers.get("accept", "")
        kind = "text/html" if wants_page else "text/plain"
        return Response(LOGIN_PAGE if wants_page else "A token is needed.\n", 401, headers, kind)

    def _is_valid(self, token: str) -> bool:
        return hmac.compare_digest(token.encode(), self.token.encode())


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

        await (access.refusal(Request(scope)) or app)(scope, receive, send_guarded)

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


class PageServer(uvicorn.Server):
    """A server that leaves signals to this process."""

    def capture_signals(self) -> nullcontext[None]:  # type: ignore[override]  # any with-block does
        """Capture none."""
        return nullcontext()


def application(routes: list[BaseRoute], access: Access) -> Starlette:
    """Return the ASGI application of a page."""
    return Starlette(
        routes=[*routes, Mount("/static", StaticFiles(directory=STATIC))],
        middleware=[
            Middleware(guard, access=access),
            Middleware(GZipMiddleware, minimum_size=1024, compresslevel=5),
        ],
        exception_handlers={QdgraspError: _error_response},
    )


def serve(
    routes: list[BaseRoute], host: str, port: int, token: str, stop: Stop, opened: Callable[[str], object]
) -> None:
    """Serve a page until this process is asked to stop.

    Browsers must send `token`; without one there is none on loopback, elsewhere a new one. As soon as the
    server listens, `opened` is called with the address for a browser, which includes a new token. An address
    that cannot be used raises `EndpointError`, a token that is too short `ImpossibleValue`.
    """
    access = Access.at(host, token)
    config = uvicorn.Config(
        application(routes, access),
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        limit_concurrency=MAX_REQUESTS,
        timeout_graceful_shutdown=CLOSING_SECONDS,
    )
    server = PageServer(config)
    stop.tell(lambda: setattr(server, "should_exit", True))
    with _listening_socket(host, port) as listener:
        opened(access.address(host, listener.getsockname()[1]))
        asyncio.run(server.serve([listener]))


def _listening_socket(host: str, port: int) -> socket.socket:
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, port), family=family, backlog=128)
    except OSError as error:
        reason = (error.strerror or str(error)).partition(" (while")[0]
        raise EndpointError(
            f"The page cannot be served at {host}:{port}: {reason}; name another place with --web."
        ) from None


def _error_response(_request: Request, error: Exception) -> Response:
    """Answer with the sentence of an error; the name of a file in it may be no text."""
    sentence = str(error).encode(errors="backslashreplace").decode()
    return JSONResponse({"error": sentence}, 404 if isinstance(error, InputError) else 503)
