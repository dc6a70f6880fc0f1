"""Carrying runs out: one campaign's folder for each version of the code, which grows stage by stage."""

import hashlib
import json
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path

from tests.benchmarks.results.plan import Costs, ordered, stages
from tests.benchmarks.results.programme import Programme, Wanted
from tests.benchmarks.results.store import Store

import qdgrasp_coordinator
from qdgrasp_assets.catalog import check_object, find_gripper
from qdgrasp_coordinator.campaigns.campaign import Campaign, campaign, read_campaign
from qdgrasp_coordinator.campaigns.campaign_folder import begin
from qdgrasp_coordinator.cli.carrying import carry_out
from qdgrasp_coordinator.folders.job_folder import JobFolder
from qdgrasp_coordinator.folders.names import CAMPAIGN
from qdgrasp_coordinator.watching.progress import display
from qdgrasp_coordinator.watching.supervisor import Team
from qdgrasp_protocol.errors import InputError, QdgraspError
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.spec import RunSpec, to_values
from qdgrasp_worker.platform import platform

NAME_DIGITS = 12
SEARCHING = ("counts/cells", "counts/tally", "runs/generation", "runs/pipeline")
"""Modules of the coordinator, beside the searches, that have a say in what is asked."""


def carry_on(store: Store, asked: Programme, runs: Path, team: Team, stop: Stop) -> list[QdgraspError]:
    """Carry out what is missing, stage by stage, and add what each one finished.

    Parameters
    ----------
    runs
        Where the folders go: one for each version of the code, so that a run goes on with its own.

    Returns
    -------
    failures
        Why some of the runs could not be carried out; the others were.
    """
    lacks = lacking(asked.wanted.values())
    failures: list[QdgraspError] = list(lacks.values())
    tried = {key for key in asked.wanted if not lacks.keys().isdisjoint((key.gripper, key.object))}
    while not stop.is_set:
        place = workplace(runs)
        _gather(store, place)
        left = [one for one in store.missing(asked) if one.key not in tried]
        if not left:
            break
        costs = Costs(store.table.values())
        stage = next(stages(ordered(left, costs), costs))
        tried |= {one.key for one in stage}
        try:
            work(place, stage, team, stop)
        except QdgraspError as error:
            failures.append(error)
        _gather(store, place)
    return failures


def lacking(runs: Collection[Wanted]) -> dict[str, InputError]:
    """The hands and objects of runs that are not on this machine, and what is to be said of each."""
    checks: dict[str, Callable[[str], object]] = {one.spec.gripper: find_gripper for one in runs} | {
        one.spec.object: check_object for one in runs
    }
    found: dict[str, InputError] = {}
    for name, check in checks.items():
        try:
            check(name)
        except InputError as error:
            found[name] = error
    return found


def _gather(store: Store, place: Path) -> None:
    """Add the rows of a workplace that are not in yet."""
    if JobFolder.is_job(place):
        store.add([place], again=False)


def workplace(home: Path) -> Path:
    """The folder below `home` for the runs of this code: of what evaluates, and of what searches."""
    said = json.dumps(platform(), sort_keys=True).encode()
    digest = hashlib.sha256(said + _search_digest())
    return home / digest.hexdigest()[:NAME_DIGITS]


def _search_digest() -> bytes:
    """The sha256 over the sources of the searches, and of what asks them."""
    here = Path(str(qdgrasp_coordinator.__file__)).parent
    sources = [*(here / f"{name}.py" for name in SEARCHING), *sorted(here.glob("searches/*.py"))]
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).digest()


def work(place: Path, stage: Sequence[Wanted], team: Team, stop: Stop) -> None:
    """Carry out a stage, and what an earlier one left undone.

    Raises
    ------
    InputError
        A run cannot be carried out; the others are.
    EndedEarly
        The coordinator died; the next stage goes on.
    """
    asked = grown(place, stage)
    extent = begin(place, asked)
    if extent.runs_done == extent.runs:
        return
    with display("results", asked.evaluations) as shown:
        carry_out(JobFolder(place), team, shown, stop)


def grown(place: Path, stage: Iterable[Wanted]) -> Campaign:
    """The campaign in a folder with a stage more; a run that is there already gets the greater budget."""
    known = read_campaign(place / CAMPAIGN).runs if (place / CAMPAIGN).is_file() else {}
    runs: dict[str, RunSpec] = dict(known)
    for one in stage:
        if one.name not in runs or runs[one.name].evaluations < one.spec.evaluations:
            runs[one.name] = one.spec
    return campaign({"cross": [to_values(spec) for spec in runs.values()]}, str(place / CAMPAIGN))
