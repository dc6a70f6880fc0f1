"""Runs the command lines and the Python of a page, in a folder of their own."""

import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from tests.common import free_port, own_endpoint

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
SPAN = re.compile(r"`(qdgrasp[ -][^`\n]*)`")  # A command that a page names in a sentence
ASSIGNMENT = re.compile(r"[A-Z_]+=")


@dataclass(frozen=True)
class Line:
    """One command line of a page."""

    page: str
    number: int
    """Number of the line in the page."""
    text: str
    """The line without its comment; continued lines are joined."""

    def __str__(self) -> str:
        return f"{self.page}:{self.number}: {self.text}"

    @property
    def program(self) -> str:
        """The program that is started first."""
        return next(word for word in self.text.split() if not ASSIGNMENT.match(word))

    @property
    def is_ours(self) -> bool:
        """True if it starts a command of this package, or a script of examples/."""
        return bool(re.match(r"qdgrasp(-\w+)?$", self.program)) or self.text.startswith("python examples/")


@dataclass(frozen=True)
class Block:
    """A block of code."""

    page: str
    language: str
    number: int
    text: str

    @property
    def lines(self) -> list[Line]:
        """Its command lines."""
        found: list[Line] = []
        begun = ""
        for number, text in enumerate(self.text.splitlines(), self.number):
            begun += bare(text)
            if begun.endswith("\\"):
                begun = begun[:-1]
            elif begun:
                found.append(Line(self.page, number, begun.strip()))
                begun = ""
        return found


def bare(text: str) -> str:
    """A line without the comment behind it."""
    quoted = re.sub(r"'[^']*'|\"[^\"]*\"", lambda found: "q" * len(found[0]), text)
    comment = re.search(r"(^|\s)#", quoted)
    return text[: comment.start()].rstrip() if comment else text.rstrip()


def blocks(page: Path, *languages: str) -> list[Block]:
    """The blocks of a page in these languages."""
    text = page.read_text(encoding="utf-8")
    name = str(page.relative_to(ROOT))
    return [
        Block(name, found[1], text.count("\n", 0, found.start(2)) + 1, found[2])
        for found in FENCE.finditer(text)
        if found[1] in languages
    ]


def words(line: Line) -> list[str]:
    """The words of a line of ours, the program first, up to a pipe or a redirection."""
    found = [word for word in shlex.split(line.text) if not ASSIGNMENT.match(word)]
    end = next((i for i, word in enumerate(found) if word in {"|", ">", ">>", "&&"}), len(found))
    return found[:end]


ELSEWHERE = {
    r"make ": "Make's targets are what `make` itself, CI and the tests run",
    r"python3\.11 -m venv|/opt/qdgrasp/bin/pip": "installs the package from the network",
    r"sh deploy/container/trim\.sh|/opt/qdgrasp/bin/qdgrasp-worker": "needs an environment from the network",
    r"git clone ": "fetches from the network",
    r".*\bleap": "needs a hand of dex-urdf",
    r"pip install viser": "installs the package from the network",
    r"python examples/viser_grasps\.py": "needs viser; tests/examples has a stand-in of it",
    r"\. \.venv/bin/activate": "enters the environment, in which tests are already",
    r"python -m (tests|benchmarks|docs)\b": "runs for minutes to hours; the modules have tests of their own",
    r"systemctl ": "needs systemd and root; the units have tests of their own (tests/deploy)",
    r".*\bsbatch ": "needs Slurm; the scripts have tests of their own (tests/deploy)",
    r".*\bdocker ": "needs Docker and the network; the files have tests of their own (tests/deploy)",
    r"kubectl ": "needs a cluster; the objects have tests of their own (tests/deploy)",
    r"python examples/own_optimiser\.py \S+ tcp/": "needs a router with workers; tests/examples has both",
    r"python \S+/replay\.py": "is run by tests of their own (tests/tools/export)",
    r"qdgrasp-monitor\b(?!.*--web)": "draws on a terminal; tests/system has one",
    r"ssh ": "needs another machine",
    r"qdgrasp asset fetch": "fetches gigabytes from the network; it has tests with a server of their own",
}
"""Lines that are not run, by their beginning, with the reason; ours are parsed all the same."""

LONG = re.compile(
    r"qdgrasp (campaign|analyse|rerank|verify|jobs|pause|continue|drain|cancel)"
    r"|qdgrasp-(router|coordinator|recorder|worker|monitor)"
    r"|qdgrasp run .*(spec\.toml|--protocol robust|--workers 0|my_hand)"
    r"|qdgrasp export (.*--holds-in|.*--verify-top|runs/\w+-robust)"  # of what verify and rerank made
    r"|qdgrasp resume .*--evaluations|qdgrasp info runs/(paper-small|budgets)"
    r"|python examples/own_"
    r"|curl "
)
"""Lines that take long: `make test-docs` and `make test-slow` run them, `make test` does not."""

SECONDS = 400.0
"""A command that takes longer fails."""

CUTS: tuple[tuple[str, str], ...] = (
    (r"(--protocol robust .*)--evaluations \d+", r"\1--evaluations 12"),
    (r"(--|--verify-)top \d+", r"\1top 2"),
    (r"--candidates \d+", "--candidates 3"),
    (r"--min-confidence \S+", "--min-confidence 0"),  # so few may all be below it
    (r"--grasps \d+ --evaluations \d+", "--grasps 20 --evaluations 60"),
    (r"(qdgrasp-worker .*)--workers \d+", r"\1--workers 1"),
    (r"--sample \d+", "--sample 5"),
    (r"--pin --grace \d+", "--pin --grace 1"),
    (r"ycb_mug", "mug"),
    (
        r"security init security --host (router|qdgrasp-router|a)\b.*",
        r"security init for-\1 --host 127.0.0.1",
    ),
    (r"^(qdgrasp security add security \w+ (\S+))", r"\1 --host 127.0.0.1 && cp -r security/\2 \2"),
    (r"--security lab-7", "--security {lab}"),
    (r"--workers 0 --listen tls/0\.0\.0\.0:7447", "--workers 1 --listen {other}"),
    (r"^(curl .*)$", r"until \1; do sleep 0.2; done"),
    (r"--host node7", "--host {hostname}"),
    (r"--host (head|router)\b", "--host 127.0.0.1"),
    (r"--connect tls/a:7447,tls/b:7447", "--connect {tls}"),
    (r"--listen tls/0\.0\.0\.0:7447 --connect tls/b:7447", "--listen {tls}"),
    (r"tls/(head|localhost|0\.0\.0\.0|a|b):\d+", "{tls}"),
    (r"tcp/127\.0\.0\.1:7447", "{tcp}"),
    (r"127\.0\.0\.1:8080", "{web}"),
    (r"localhost:8080", "{web}"),
)
"""Patterns of a line, and what is run instead of what they match."""

DEFAULTS: tuple[tuple[str, str, str], ...] = (
    (r"qdgrasp (run|optimise) (?!.*(--evaluations|spec\.toml))", "--evaluations", "60"),
    (r"qdgrasp (run|resume|campaign|rerank|evaluate|verify) (?!.*(--workers|--list))", "--workers", "1"),
    (r"qdgrasp run (?=.*--workers 0)(?!.*--listen)", "--listen", "{tcp}"),
    (r"qdgrasp (run|resume|campaign|rerank) (?!.*--list)", "--listen", "{own}"),
    (r"qdgrasp (jobs|pause|continue|drain|cancel)\b(?!.*--connect)", "--connect", "{tcp}"),
    (r"qdgrasp-(monitor|worker)\b(?!.*--connect)", "--connect", "{tcp}"),
)
"""Flags added to lines that a pattern matches: a budget, an endpoint of its own."""

SERVICES: dict[str, str] = {
    r"qdgrasp-router": "listening",
    r"qdgrasp-coordinator": "connected|listening",
    r"qdgrasp-recorder": "",
    r"qdgrasp-worker": "",
    r"qdgrasp-monitor.*--web": r"http://",
    r"qdgrasp view": r"http://",
    r"qdgrasp (run|campaign) .*--workers 0": "listening on",
    r"python examples/own_evaluator\.py": "",
}
"""Lines that go on until they are stopped, with the words to wait for; empty: none."""

JOBS = r"qdgrasp-coordinator|qdgrasp (run|campaign)"
"""Of these the ones that end by themselves, when their job is done."""


def reason(text: str) -> str:
    """The reason for which a line is not run here; empty: it is run."""
    return next((why for pattern, why in ELSEWHERE.items() if re.match(pattern, text)), "")


def budget(evaluations: int) -> int:
    """A budget that is cut, and in the order of those that were asked for."""
    return 60 + evaluations // 2500


def cut(text: str, places: dict[str, str]) -> str:
    """The line that is run: budgets cut, machines and ports replaced by what there is here."""
    text = re.sub(r"--evaluations (\d+)", lambda found: f"--evaluations {budget(int(found[1]))}", text)
    for pattern, instead in CUTS:
        text = re.sub(pattern, instead, text)
    end = re.search(r"[|>]|$", text)
    assert end is not None
    head, rest = text[: end.start()], text[end.start() :]
    for pattern, flag, value in DEFAULTS:
        if re.match(pattern, head):
            head = f"{head.rstrip()} {flag} {value}".rstrip() + " "
    text = (head + rest).strip()
    for name, place in places.items():
        text = text.replace(f"{{{name}}}", place)
    return text


def service(text: str) -> str | None:
    """The words of `SERVICES` that a line is ready with; None: it ends by itself."""
    return next((ready for pattern, ready in SERVICES.items() if re.match(pattern, text)), None)


STANDING = "qdgrasp run --gripper panda --object mug --workers 1 --evaluations 1000000 --out standing"
ASKS = r"qdgrasp (jobs|pause|continue|drain|cancel)|qdgrasp-(monitor|worker|recorder)"
"""Lines that want a job to be there."""


@dataclass
class Started:
    """A process that was started, and the file of what it says."""

    line: str
    process: subprocess.Popen[bytes]
    file: Path

    @property
    def said(self) -> str:
        """All that it has said by now."""
        return self.file.read_text(errors="replace")

    def says(self, pattern: str) -> None:
        """Wait until it has said something."""
        end = time.monotonic() + SECONDS
        while not re.search(pattern, self.said) and self.process.poll() is None and time.monotonic() < end:
            time.sleep(0.05)
        assert re.search(pattern, self.said), f"never said '{pattern}': {self.line}\n{self.said}"

    def ends(self, *codes: int) -> None:
        """Wait for its end, which is to be one of these."""
        try:
            code = self.process.wait(SECONDS)
        except subprocess.TimeoutExpired:
            code = None
        assert code in codes, f"ended with {code}: {self.line}\n{self.said[-3000:]}"

    def stop(self) -> None:
        """Ask it to end; all that it has started ends with it."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGTERM)


class PageRun:
    """Carries out the lines of a page in a folder; the cache is kept between pages."""

    def __init__(self, home: Path, cache: Path) -> None:
        self.home = home
        tcp = own_endpoint()
        self.places = {
            "tcp": tcp,
            "own": own_endpoint(),
            "tls": own_endpoint("tls"),
            "other": own_endpoint("tls"),
            "lab": "lab-7",
            "web": f"127.0.0.1:{free_port()}",
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
        self._said = Path(tempfile.mkdtemp())

    def tell(self, lines: list[Line]) -> None:
        """Carry the lines of a block out; what goes on until it is stopped is stopped at its end."""
        texts = [cut(line.text, self.places) for line in lines]
        standing = self._stand(texts)
        services: list[Started] = []
        for line, text in zip(lines, texts, strict=True):
            ready = service(text)
            started = self._start(text, line)
            if ready is None:
                started.ends(0)
            else:
                started.says(self._ready(ready, text, [*texts, *(one.line for one in standing)]))
                services.append(started)
        for started in services:
            if re.match(JOBS, started.line):
                started.ends(0)
        self._end(services, standing)

    def close(self) -> None:
        """End all processes that are still there."""
        for started in self._started:
            started.stop()
        for started in self._started:
            started.process.wait(SECONDS)
        shutil.rmtree(self._said)

    def _stand(self, texts: list[str]) -> list[Started]:
        """Start jobs where lines ask for one, and none of them listens there."""
        jobs = []
        for place, security in ((self.places["tcp"], ""), (self.places["tls"], "--security security")):
            is_asked = any(re.match(ASKS, text) and place in text for text in texts)
            if is_asked and not any(f"--listen {place}" in text for text in texts):
                jobs.append(self._start(f"{STANDING}-{len(self._started)}/mugs --listen {place} {security}"))
        for job in jobs:
            job.says(r"listening on(.|\n)* [1-9]\d* workers?")
        return jobs

    def _ready(self, ready: str, text: str, others: list[str]) -> str:
        """The words of a service that is ready: a worker that finds a job has joined it."""
        if not re.match(r"qdgrasp-worker|python examples/own_evaluator", text):
            return ready
        place = next(word for word in text.split() if "/127.0.0.1:" in word)
        jobs = [other for other in others if re.match(JOBS, other) and place in other]
        return "joined|takes? this worker" if jobs else ready

    def _end(self, services: list[Started], standing: list[Started]) -> None:
        for started in [*reversed(services), *standing]:
            started.stop()
        for started in services:
            started.ends(0, 128 + signal.SIGTERM, -signal.SIGTERM)
        for started in standing:
            started.ends(0, 1, 128 + signal.SIGTERM, -signal.SIGTERM)

    def _start(self, text: str, line: Line | None = None) -> Started:
        file = self._said / f"{len(self._started)}.txt"
        with file.open("wb") as out:
            process = subprocess.Popen(
                ["/bin/bash", "-c", f"set -o pipefail; {_without_shell(text)}"],
                cwd=self.home,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        started = Started(f"{text}  ({line})" if line else text, process, file)
        self._started.append(started)
        return started


def _without_shell(text: str) -> str:
    """A line that is one program, without a shell that would outlive it."""
    is_plain = not re.search(r"[|><;&$]", text) and shlex.split(text)[0].startswith(("qdgrasp", "python"))
    return f"exec {text}" if is_plain else text
