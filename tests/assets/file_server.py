"""A web server on loopback that serves one file, and misbehaves as it is told."""

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


class Answer(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: "Server"

    def do_GET(self):
        site = self.server.site
        site.asked.append((self.path, self.headers.get("Range")))
        behaviour = site.behaviours.pop(0) if site.behaviours else whole
        behaviour(self, site)
        self.close_connection = True

    def head(self, status, length, **headers):
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name.replace("_", "-"), value)
        if length is not None:
            self.send_header("Content-Length", str(length))
        self.end_headers()

    def log_message(self, *_):
        pass


class Server(ThreadingHTTPServer):
    daemon_threads = True
    site: "Site"


Behaviour = Callable[[Answer, "Site"], None]


@dataclass
class Site:
    """The served content, behaviours for the next requests, and the requests so far."""

    content: bytes = b""
    etag: str | None = '"one"'
    behaviours: list[Behaviour] = field(default_factory=list)
    asked: list[tuple[str, str | None]] = field(default_factory=list)
    over: threading.Event = field(default_factory=threading.Event)
    address: str = ""

    @property
    def ranges(self) -> list[str | None]:
        return [asked for _, asked in self.asked]


@contextmanager
def served() -> Iterator[Site]:
    site = Site()
    with Server(("127.0.0.1", 0), Answer) as server:
        server.site = site
        site.address = f"http://127.0.0.1:{server.server_port}"
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield site
        site.over.set()
        server.shutdown()
        thread.join()


def _started(answer, site) -> bytes:
    """Answer as a good server does, up to the body; return the body."""
    tag = {"ETag": site.etag} if site.etag else {}
    asked = re.fullmatch(r"bytes=(\d+)-", answer.headers.get("Range", ""))
    if asked and answer.headers.get("If-Range", site.etag) == site.etag:
        start, total = int(asked[1]), len(site.content)
        if start >= total:
            answer.head(416, 0, Content_Range=f"bytes */{total}")
            return b""
        answer.head(206, total - start, Content_Range=f"bytes {start}-{total - 1}/{total}", **tag)
        return site.content[start:]
    answer.head(200, len(site.content), **tag)
    return site.content


def whole(answer, site):
    answer.wfile.write(_started(answer, site))


def cut(bytes_sent: int) -> Behaviour:
    """Close the connection early."""

    def behaviour(answer, site):
        answer.wfile.write(_started(answer, site)[:bytes_sent])

    return behaviour


def stall(bytes_sent: int) -> Behaviour:
    """Send nothing more, and keep the connection."""

    def behaviour(answer, site):
        answer.wfile.write(_started(answer, site)[:bytes_sent])
        answer.wfile.flush()
        site.over.wait()

    return behaviour


def trickle(answer, site):
    """Send the body in many small pieces."""
    body = _started(answer, site)
    for start in range(0, len(body), 1000):
        answer.wfile.write(body[start : start + 1000])
        answer.wfile.flush()


def without_ranges(answer, site):
    """Send the whole file for any request."""
    answer.head(200, len(site.content))
    answer.wfile.write(site.content)


def without_length(answer, site):
    """Say nothing of the length."""
    answer.head(200, None)
    answer.wfile.write(site.content)


def another_range(answer, site):
    total = len(site.content)
    answer.head(206, total, Content_Range=f"bytes 0-{total - 1}/{total}")
    answer.wfile.write(site.content)


def claims(length: int) -> Behaviour:
    return lambda answer, _site: answer.head(200, length)


def fails(status: int) -> Behaviour:
    return lambda answer, _site: answer.head(status, 0)
