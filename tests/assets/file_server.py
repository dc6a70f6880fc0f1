"""A web server on loopback that serves one file, and misbehaves as it is told."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


class Answer(BaseHTTPRequestHandler):
    server: "Server"

    def do_GET(self):
        site = self.server.site
        site.asked.append(self.path)
        (site.behaviours.pop(0) if site.behaviours else cut(len(site.content)))(self, site)

    def head(self, status, length):
        self.send_response(status)
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
    behaviours: list[Behaviour] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)
    address: str = ""


@contextmanager
def served() -> Iterator[Site]:
    site = Site()
    with Server(("127.0.0.1", 0), Answer) as server:
        server.site = site
        site.address = f"http://127.0.0.1:{server.server_port}"
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield site
        server.shutdown()
        thread.join()


def cut(bytes_sent: int) -> Behaviour:
    """Say the whole length, and close the connection after some bytes."""

    def behaviour(answer, site):
        answer.head(200, len(site.content))
        answer.wfile.write(site.content[:bytes_sent])

    return behaviour


def claims(length: int) -> Behaviour:
    return lambda answer, _site: answer.head(200, length)


def fails(status: int) -> Behaviour:
    return lambda answer, _site: answer.head(status, 0)
