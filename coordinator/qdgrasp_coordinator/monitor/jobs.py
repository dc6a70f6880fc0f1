"""The jobs on a bus, as whoever watches knows them: told what was heard, they say what there is to see.

Nothing here knows a clock, a bus or a thread: time is passed in, in seconds since 1970, and questions that
are to be asked are handed out.
"""

from collections.abc import Mapping

from qdgrasp_coordinator.monitor.job import AGAIN, SILENCE, Job
from qdgrasp_coordinator.monitor.view import JobView
from qdgrasp_protocol.keys import AnyJob, Keys, job_of, matches

__all__ = ["JobView", "Jobs"]

MOST = 64
"""So many jobs are known at most; those that were heard of last."""
ALL = ""
"""Stands for all jobs there are."""


class Jobs:
    """All jobs that were heard of.

    Parameters
    ----------
    keys
        Which are watched; of others nothing is to be told.
    """

    def __init__(self, keys: Keys | None = None) -> None:
        self._keys = keys or AnyJob()
        self.is_linked = True
        """False while there is no way to the router."""
        self._linked_at = 0.0
        self._jobs: dict[str, Job] = {}
        self._due: dict[str, float] = {ALL: 0.0}  # when to ask about a job

    # What comes.

    def heard(self, key: str, payload: bytes, now: float) -> None:
        """Take a message; what is no message of ours is left alone."""
        if job := self._job(key):
            job.heard(key, payload, now)
            if not job.is_known:
                self._due.setdefault(job.name, now)

    def answered(self, values: Mapping[str, bytes], now: float) -> None:
        """Take the answers to a question, by their keys: whose they are first, curves behind their runs."""
        curve, meta = AnyJob().stat("curve/*"), AnyJob().meta
        for key in sorted(values, key=lambda key: (not matches(meta, key), matches(curve, key))):
            if job := self._job(key):
                job.heard(key, values[key], now)
        known = {job.name for job in self._jobs.values() if job.is_known}
        self._due = {name: at for name, at in self._due.items() if at <= now or name not in known}

    def token(self, key: str, alive: bool, now: float) -> None:
        """Hear of a coordinator that it is there, or gone."""
        if matches(AnyJob().coordinator_token(), key) and (job := self._job(key)):
            if alive:
                self._due[job.name] = now
            job.token(key, alive, now, is_linked=self.is_linked)

    def linked(self, is_linked: bool, now: float) -> None:
        """Hear whether there is a way to the router."""
        self.is_linked = is_linked
        if is_linked:
            self._linked_at = self._due[ALL] = now
        for job in self._jobs.values():
            if not is_linked:
                job.cut_off(now)

    # What is to be asked.

    def questions(self, now: float) -> list[str]:
        """Patterns to ask now: everything at first and when the router is back, a job when it begins."""
        if not self.is_linked:
            return []
        due = {name for name, at in self._due.items() if at <= now}
        unknown = {name for name, job in self._jobs.items() if not job.is_known and due & {name, ALL}}
        self._due = {name: at for name, at in self._due.items() if name not in due}
        self._due |= dict.fromkeys(unknown, now + AGAIN)
        whose: list[Keys] = [self._keys] if ALL in due else [Keys(name) for name in sorted(due)]
        asked = [pattern for keys in whose for pattern in patterns(keys)]
        curves = [key for job in self._jobs.values() for key in job.questions(now)]
        return asked + [key for key in curves if not any(matches(pattern, key) for pattern in asked)]

    # What is shown.

    def views(self, now: float) -> list[JobView]:
        """The jobs of which enough is known, by their names."""
        is_linked = self.is_linked and now > self._linked_at + SILENCE
        views = [self._jobs[name].view(now, is_linked=is_linked) for name in sorted(self._jobs)]
        return [view for view in views if view is not None]

    @property
    def strangers(self) -> list[str]:
        """Jobs that are there, and whose coordinators speak as another version of qdgrasp does."""
        return sorted(job.name for job in self._jobs.values() if not job.is_readable)

    def _job(self, key: str) -> Job | None:
        name = job_of(key)
        if name is None:
            return None
        if name not in self._jobs:
            self._make_room()
            self._jobs[name] = Job(name)
        return self._jobs[name]

    def _make_room(self) -> None:
        """Forget the job of which nothing was heard for longest, where there is no room for another."""
        if len(self._jobs) >= MOST:
            del self._jobs[min(self._jobs, key=lambda name: self._jobs[name].heard_at)]


def patterns(keys: Keys) -> list[str]:
    """All that is asked about a job."""
    return [keys.stat(), keys.stat("curve/*"), keys.meta, keys.recent]
