"""The ratchet: counts of jobs and runs that do not fall where another coordinator goes on with them.

What a coordinator told and a recorder had not written is lost with it, and found again; runs are opened again
one by one. To whoever takes differences of counts, all that was ever found would seem to be found at once.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeVar

from msgspec import structs

from qdgrasp_coordinator.counts.figures import Figures, JobFigures, JobMeta
from qdgrasp_coordinator.monitor.jobs import JobView

Found = TypeVar("Found", Figures, JobFigures)


class Ratchet:
    """Remembers what jobs had come to.

    Parameters
    ----------
    fields
        The counts, numbers or numbers by name, that are kept from falling where jobs or runs have them.
    """

    def __init__(self, fields: Iterable[str]) -> None:
        self._fields = frozenset(fields)
        self._before: dict[str, JobView] = {}

    def raised(self, views: Sequence[JobView]) -> list[JobView]:
        """The jobs, with no count below what it was while the job went on; of what is over, as it is."""
        raised = [self._raised(view) for view in views]
        self._before = {view.job: self._noted(view) for view in raised}
        return raised

    def _raised(self, view: JobView) -> JobView:
        before = self._before.get(view.job)
        if before is None or not goes_on(before.meta, view.meta):
            return view
        runs, job = {run.run: run for run in before.runs}, view.figures
        return structs.replace(
            view,
            figures=job if job.runs_done + job.runs_failed == job.runs else self._most(before.figures, job),
            runs=[run if run.finished else self._most(runs.get(run.run, run), run) for run in view.runs],
        )

    def _most(self, before: Found, now: Found) -> Found:
        fields = self._fields.intersection(now.__struct_fields__)
        return structs.replace(
            now, **{name: _greater(getattr(before, name), getattr(now, name)) for name in fields}
        )

    def _noted(self, view: JobView) -> JobView:
        """What is remembered: a coordinator without a turn does not yet say whose work it goes on with."""
        before = self._before.get(view.job)
        return structs.replace(view, meta=before.meta) if before and not view.meta.epoch else view


def goes_on(before: JobMeta, now: JobMeta) -> bool:
    """Whether it is the coordinator of before, or one that goes on with its work: turns are counted."""
    return now.since == before.since or not now.epoch or now.epoch > before.epoch


def _greater(before: Any, now: Any) -> Any:
    if isinstance(now, Mapping):
        return {name: max(before.get(name, 0), count) for name, count in now.items()}
    return max(before, now)
