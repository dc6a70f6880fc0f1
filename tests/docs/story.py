"""A page as a story: its lines are carried out one after the other, in a folder of their own."""

import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path

from tests.docs import rules
from tests.docs.blocks import Line
from tests.endpoints import own_endpoint

STANDING = (
    "qdgrasp run --gripper panda --object mug --job mugs --workers 1 --evaluations 1000000 --out standing"
)
ASKS = r"qdgrasp (jobs|pause|continue|drain|cancel)|qdgrasp-(monitor|worker|recorder)|qdgrasp security check"
"""Lines that want a job to be there."""


@dataclass
class Started:
    """A process that was started, and what it has said."""

    line: str
    process: subprocess.Popen[str]
    said: str = ""
    _is_over: bool = False
    _news: threading.Condition = field(default_factory=threading.Condition)

    def __post_init__(self) -> None:
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for piece in iter(lambda: os.read(self.process.stdout.fileno(), 4096), b""):  # type: ignore[union-attr]
            with self._news:
                self.said += piece.decode(errors="replace")
                self._news.notify_all()
        with self._news:
            self._is_over = True
            self._news.notify_all()

    def says(self, pattern: str) -> None:
        """Wait until it has said something."""
        with self._news:
            self._news.wait_for(lambda: re.search(pattern, self.said) or self._is_over, rules.SECONDS)
        assert re.search(pattern, self.said), f"never said '{pattern}': {self.line}\n{self.said}"

    def ends(self, *codes: int) -> None:
        """Wait for its end, which is to be one of these."""
        try:
            code = self.process.wait(rules.SECONDS)
        except subprocess.TimeoutExpired:
            code = None
        self._reader.join(rules.SECONDS)
        assert code in codes, f"ended with {code}: {self.line}\n{self.said[-3000:]}"

    def stop(self) -> None:
        """Ask it to end; all that it has started ends with it."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGTERM)


class Story:
    """Carries out the lines of a page.

    Parameters
    ----------
    home
        The folder in which they are carried out.
    cache
        Where convex parts and scenes are kept between pages.
    """

    def __init__(self, home: Path, cache: Path) -> None:
        self.home = home
        tcp = own_endpoint()
        self.places = {
            "tcp": tcp,
            "own": own_endpoint(),
            "tls": own_endpoint().replace("tcp/", "tls/"),
            "other": own_endpoint().replace("tcp/", "tls/"),
            "lab": "lab-7",
            "web": own_endpoint().removeprefix("tcp/"),
            "hostname": socket.gethostname(),
        }
        programs = Path(sys.executable).parent
        self._environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith("QDGRASP_")},
            "PATH": f"{programs}:{os.environ['PATH']}",
            "QDGRASP_CACHE": str(cache),
            "QDGRASP_NICE": "0",
            "COLUMNS": "100",
        }
        self._started: list[Started] = []

    def tell(self, lines: list[Line]) -> None:
        """Carry the lines of a block out; what goes on until it is stopped is stopped at its end."""
        texts = [rules.cut(line.text, self.places) for line in lines]
        standing = self._stand(texts)
        services: list[Started] = []
        for line, text in zip(lines, texts, strict=True):
            ready = rules.service(text)
            started = self._start(text, line)
            if ready is None:
                started.ends(0)
            else:
                started.says(self._ready(ready, text, [*texts, *(one.line for one in standing)]))
                services.append(started)
        for started in services:
            if re.match(rules.JOBS, started.line):
                started.ends(0)
        self._end(services, standing)

    def close(self) -> None:
        """End whatever is still there."""
        for started in self._started:
            started.stop()
        for started in self._started:
            started.process.wait(rules.SECONDS)

    def _stand(self, texts: list[str]) -> list[Started]:
        """Start jobs where lines ask for one, and none of them listens there."""
        jobs = []
        for place, security in ((self.places["tcp"], ""), (self.places["tls"], "--security security")):
            is_asked = any(re.match(ASKS, text) and place in text for text in texts)
            if is_asked and not any(f"--listen {place}" in text for text in texts):
                jobs.append(self._start(f"{STANDING}-{len(self._started)} --listen {place} {security}"))
        for job in jobs:
            job.says(r"listening on(.|\n)* [1-9]\d* workers")
        return jobs

    def _ready(self, ready: str, text: str, others: list[str]) -> str:
        """What a service says when it is ready: a worker that finds a job has joined it."""
        if not re.match(r"qdgrasp-worker|python examples/own_evaluator", text):
            return ready
        place = next(word for word in text.split() if "/127.0.0.1:" in word)
        jobs = [other for other in others if re.match(rules.JOBS, other) and place in other]
        return "joined|takes? this worker" if jobs else ready

    def _end(self, services: list[Started], standing: list[Started]) -> None:
        for started in [*reversed(services), *standing]:
            started.stop()
        for started in services:
            started.ends(0, 128 + signal.SIGTERM, -signal.SIGTERM)
        for started in standing:
            started.ends(0, 1, 128 + signal.SIGTERM, -signal.SIGTERM)

    def _start(self, text: str, line: Line | None = None) -> Started:
        process = subprocess.Popen(
            ["/bin/bash", "-c", f"set -o pipefail; {_without_shell(text)}"],
            cwd=self.home,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        started = Started(f"{text}  ({line})" if line else text, process)  # type: ignore[arg-type]
        self._started.append(started)
        return started


def _without_shell(text: str) -> str:
    """A line that is one program, without a shell that would outlive it."""
    is_plain = not re.search(r"[|><;&$]", text) and shlex.split(text)[0].startswith(("qdgrasp", "python"))
    return f"exec {text}" if is_plain else text
