"""The keys of `qdgrasp/v1`: built, parsed and validated here and nowhere else.

Chunks that start with `@` are verbatim in zenoh: `qdgrasp/**` does not match them, so that a careless
subscriber cannot hear, or slow, the bulk of the traffic.
"""

import re

from qdgrasp_protocol.errors import ImpossibleValue

ROOT = "qdgrasp/v1"
NAME = re.compile(r"[a-z0-9_-]{1,64}")
WID = re.compile(r"[0-9a-f]{32}")


def job_name(text: str) -> str:
    """Reduce any text, such as a folder's name, to the characters a job's name may have."""
    return re.sub(r"[^a-z0-9_-]+", "-", text.lower()).strip("-")[:64] or "job"


class Keys:
    """The keys of one job; an ImpossibleValue if its name is not of the allowed characters."""

    _allowed = NAME

    def __init__(self, job: str) -> None:
        if not self._allowed.fullmatch(job):
            raise ImpossibleValue("job", job, "1 to 64 of the characters a-z, 0-9, '_' and '-'")
        self.job = job
        self.root = f"{ROOT}/{job}"
        self.join = f"{self.root}/rpc/join"
        """Worker to coordinator, query: join, rejoin."""
        self.control = f"{self.root}/rpc/control"
        """Administrator to coordinator, query: pause, continue, cancel, drain."""
        self.recorded = f"{self.root}/@recorded"
        """Recorder to coordinator: the highest durable number."""
        self.open = f"{self.root}/rec/open"
        """Coordinator to recorder, query: opens a job."""
        self.log = f"{self.root}/rec/log"
        """Anyone to recorder, query: recorded rows from a number on."""
        self.entries = f"{self.root}/rec/runs"
        """Monitors to recorder, query: all runs in the folder, finished ones too, or one; JSON."""
        self.objects = f"{self.root}/rec/objects"
        """Monitors to recorder, query `?from=<number>`: objects of a campaign and what they got; JSON."""
        self.finds = f"{self.root}/rec/finds"
        """Monitors to recorder, query `?run=<run>&from=<number>`: successes of a run from a row on."""
        self.recent = f"{self.root}/event/recent"
        """Monitors to coordinator, query: the latest events, JSON."""
        self.meta = f"{self.root}/meta"
        """To monitors: description of a job, JSON, at a coordinator's start; also on query."""

    def work(self, wid: str) -> str:
        """Coordinator to worker: a leased batch."""
        return f"{self.root}/@work/{wid}"

    def result(self, wid: str = "*") -> str:
        """Worker to coordinator: its result."""
        return f"{self.root}/@result/{wid}"

    def ctl(self, wid: str) -> str:
        """Coordinator to worker: batches to drop, or an order to leave."""
        return f"{self.root}/@ctl/{wid}"

    def asset(self, digest: str = "*") -> str:
        """Worker to coordinator, query per chunk: a scene bundle by its digest."""
        return f"{self.root}/@asset/{digest}"

    def outcome(self, epoch: int | None = None) -> str:
        """Coordinator to recorder: settled rows."""
        return f"{self.root}/@outcome/{'*' if epoch is None else epoch}"

    def coordinator_token(self, epoch: int | None = None) -> str:
        """Liveliness of a coordinator."""
        return f"{self.root}/live/coord/{'*' if epoch is None else epoch}"

    def worker_token(self, wid: str = "*") -> str:
        """Liveliness of a worker."""
        return f"{self.root}/live/worker/{wid}"

    def recorder_token(self, rid: str = "*") -> str:
        """Liveliness of a recorder."""
        return f"{self.root}/live/recorder/{rid}"

    def recorded_asset(self, digest: str = "*") -> str:
        """Monitors to recorder, query per chunk: a scene bundle by its digest."""
        return f"{self.root}/rec/asset/{digest}"

    def stat(self, what: str = "**") -> str:
        """To monitors: `job`, `run/<run>` or `team/<page>`, JSON, about once a second.

        The coordinator also answers queries on it, patterns too, with the present state. On
        `worker/<wid>` a worker publishes its own progress.
        """
        return f"{self.root}/stat/{what}"

    def event(self, kind: str = "*") -> str:
        """To monitors: an event, JSON, when it happens."""
        return f"{self.root}/event/{kind}"


class AnyJob(Keys):
    """Patterns over the keys of all jobs, for workers that serve any job."""

    _allowed = re.compile(r"\*")

    def __init__(self) -> None:
        super().__init__("*")


def job_of(key: str) -> str | None:
    """Return the job that a key belongs to; None where the key is not one of ours."""
    parts = key.split("/")
    if len(parts) < 4 or "/".join(parts[:2]) != ROOT or not NAME.fullmatch(parts[2]):
        return None
    return parts[2]


def last_chunk(key: str) -> str:
    """Return the chunk after the last slash: a worker's id, an epoch, a digest."""
    return key.rsplit("/", 1)[-1]


def parse_number(text: str) -> int | None:
    """Parse a number of at most 18 digits in a key or parameter; None if it is not one."""
    is_one = text.isascii() and text.isdigit() and len(text) <= 18
    return int(text) if is_one else None


def matches(pattern: str, key: str) -> bool:
    """Return whether a key, or one of those of another pattern, matches a pattern.

    `*` stands for one chunk, `**` for any number, neither for `@...`.
    """
    return _intersect(pattern.split("/"), key.split("/"))


def _intersect(one: list[str], other: list[str]) -> bool:
    if not one or not other:
        return all(chunk == "**" for chunk in one or other)
    for first, second in ((one, other), (other, one)):
        if first[0] == "**":
            is_passed = not second[0].startswith("@") and _intersect(first, second[1:])
            return is_passed or _intersect(first[1:], second)
    is_any = "*" in (one[0], other[0]) and not (one[0] + other[0]).strip("*").startswith("@")
    return (one[0] == other[0] or is_any) and _intersect(one[1:], other[1:])
