"""Carries missing runs out, stage by stage, and stores their results in table and page."""

import hashlib
import json
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

import msgspec
from benchmarks.results import reference_sets
from benchmarks.results import table as tables
from benchmarks.results.assets import asset_name, has_own_mass, make_asset
from benchmarks.results.benchmark import FIGURE, draw
from benchmarks.results.comparison import arms
from benchmarks.results.drawn_grasps import drawn_figures
from benchmarks.results.measure import Figures, finished_rows, rounded
from benchmarks.results.page import page
from benchmarks.results.paper_claims import CAMPAIGN as CLAIMS
from benchmarks.results.paper_claims import SIGMA_GRID
from benchmarks.results.paper_figures import FIGURE as PAPERS
from benchmarks.results.paper_figures import draw as draw_papers
from benchmarks.results.programme import Costs, Programme, Wanted, located, ordered, stages
from benchmarks.results.table import Key, Row, key
from benchmarks.side_by_side import side_by_side
from msgspec import structs

import qdgrasp_coordinator
from qdgrasp_assets.catalog import check_object, find_gripper
from qdgrasp_coordinator.metrics.reference_coverage import ReferenceLookup
from qdgrasp_coordinator.storage import atomic_files
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.outputs import CAMPAIGN
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import InputError, QdgraspError
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.spec import RunSpec, to_values
from qdgrasp_tools.campaign.campaign_file import Campaign, make_campaign, read_campaign
from qdgrasp_tools.campaign.campaign_folder import begin_campaign
from qdgrasp_tools.cli.run_commands import run_job
from qdgrasp_tools.local.progress import progress_display
from qdgrasp_tools.local.supervisor import LocalJobConfig
from qdgrasp_tools.report.figure_grid import FIGURE_DPI
from qdgrasp_tools.report.run_groups import search_run_folders
from qdgrasp_worker.platform import platform

PAGE = "index.md"


class Added(msgspec.Struct, frozen=True):
    """The result of adding runs."""

    new: int
    """Rows that are new, or have changed."""
    kept: int
    """Rows that were left out, as the table has them of today's code."""
    without_set: tuple[str, ...]
    """Scenes of which no reference set is known on this machine."""
    whole: int
    """Rows in the table."""

    @property
    def words(self) -> str:
        """Summary for a reader."""
        kept = f"; {self.kept} of other code were left out" if self.kept else ""
        no_set = (
            f" No S_G on this machine of {', '.join(self.without_set)}: no coverage."
            if self.without_set
            else ""
        )
        return f"{self.new} new rows, {self.whole} in all{kept}.{no_set}"


class Store:
    """A table with its page beside it.

    Parameters
    ----------
    file
        The table.
    known
        The programme, for the page and for missing runs.
    current
        Digests of evaluation code that count as today's.
    """

    def __init__(self, file: Path, known: Programme, current: Collection[str]) -> None:
        self.file = file
        self.known = known
        self._current = current

    @property
    def sets(self) -> Path:
        """The folder of the reference sets that the runs make."""
        return self.file.with_name(reference_sets.FOLDER)

    @property
    def table(self) -> dict[Key, Row]:
        """The table as it is now; raises as `table.read`."""
        return tables.read(self.file)

    def missing(self, asked: Programme) -> list[Wanted]:
        """The runs of a programme that the table lacks, of today's code."""
        return asked.missing(self.table, self._current)

    def add(self, directories: Collection[Path], *, again: bool = True) -> Added:
        """Add the finished runs in folders, and make the page again if that changes anything.

        Runs of the benchmark and of the paper's claims go into the reference sets of their scenes, too.

        Parameters
        ----------
        again
            Whether runs that the table has of today's code are read again, too.
        """
        here = {} if again else self.table
        found = [
            row for path in directories for row in finished_rows(path, self._budgets(here), ReferenceLookup())
        ]
        with tables.locked(self.file):
            before = self.table
            after = tables.merged(before, found, self._current)
            if has_changed := after != before or not self.file.exists():
                tables.write(self.file, after)
            in_sets = {**self.known.benchmark.wanted, **self.known.part(CLAIMS).wanted}
            rows = {one: after[one] for one in in_sets if one in after and after[one].code in self._current}
            if (
                reference_sets.gather(self.sets, folders_by_key(directories), rows, self._current)
                or has_changed
            ):
                self.write_page()
        return Added(
            new=sum(before.get(key) != row for key, row in after.items()),
            kept=sum(after[row.key] != row for row in found),
            without_set=tuple(
                sorted({f"{row.gripper} on {row.object}" for row in found if row.set_size is None})
            ),
            whole=len(after),
        )

    def without_drawn(self, asked: Programme) -> set[Key]:
        """The runs of a programme with a row of today's code that lacks drawn grasps."""
        table = self.table
        rows = [table[one] for one in asked.wanted if one in table]
        return {row.key for row in rows if row.drawn is None and row.code in self._current}

    def put(self, key: Key, figures: Figures) -> None:
        """Change figures of a row."""
        with tables.locked(self.file):
            table = self.table
            table[key] = structs.replace(table[key], **rounded(figures))
            tables.write(self.file, table)

    def write_page(self) -> None:
        """Make the page again, its figure, and the table as Parquet."""
        whole = self.table
        sets = reference_sets.read(self.sets)
        claimed, sigma = (arms(self.known.part(name), whole) for name in (CLAIMS, SIGMA_GRID))
        figures = {FIGURE: draw(arms(self.known.benchmark, whole)), PAPERS: draw_papers(claimed, sigma)}
        with atomic_files.writing(self.file.parent):
            atomic_files.write(self.file.with_name(PAGE), page(self.known, whole, sets).encode())
            atomic_files.write(self.file.with_suffix(".parquet"), tables.parquet(whole))
            for name, figure in figures.items():
                if figure is not None:
                    figure.figure.savefig(self.file.with_name(f"{name}.png"), dpi=FIGURE_DPI)

    def _budgets(self, here: tables.Table) -> "_Budgets":
        return _Budgets(self.known, {one for one, row in here.items() if row.code in self._current})


class _Budgets:
    """The budgets of a run whose rows are of use: its own and the programme's, less those that are in."""

    def __init__(self, known: Programme, done: Collection[Key]) -> None:
        self._known = known
        self._done = done

    def __call__(self, asked: Key) -> set[int]:
        budgets = self._known.budgets(asked) | {asked.budget}
        return {budget for budget in budgets if asked._replace(budget=budget) not in self._done}


NAME_DIGITS = 12
SEARCHING = ("metrics/cells", "metrics/run_stats", "scheduler/pipeline")
"""Modules of the coordinator, beside the searches, that affect which genomes are asked."""


def run_missing(
    store: Store, asked: Programme, runs: Path, config: LocalJobConfig, stop: Stop
) -> list[QdgraspError]:
    """Carry out missing runs, stage by stage, add the finished runs of each, and evaluate their drawn grasps.

    Parameters
    ----------
    runs
        Where the folders go: one for each version of the code, so that a run goes on with its own; and one
        for the benchmark's own hands and objects.

    Returns
    -------
    failures
        Why some of the runs could not be carried out; the others were.
    """
    asked = located(asked, runs)
    missing = missing_assets(store.missing(asked))
    failures: list[QdgraspError] = list(missing.values())
    tried = {
        key
        for key, one in asked.wanted.items()
        if not missing.keys().isdisjoint((one.spec.gripper, one.spec.object))
    }
    without_drawn: dict[Key, QdgraspError] = {}
    while not stop.is_set:
        place = code_folder(runs)
        _add_finished(store, place)
        without_drawn |= evaluate_drawn(store, asked, place, config.workers, stop)
        left = [one for one in store.missing(asked) if one.key not in tried]
        if not left or stop.is_set:
            break
        costs = Costs(store.table.values())
        stage = next(stages(ordered(left, costs), costs))
        tried |= {one.key for one in stage}
        try:
            run_stage(place, stage, config, stop)
        except QdgraspError as error:
            failures.append(error)
        _add_finished(store, place)
    return [*failures, *without_drawn.values()]


def evaluate_drawn(
    store: Store, asked: Programme, place: Path, processes: int, stop: Stop
) -> dict[Key, QdgraspError]:
    """Evaluate drawn grasps of the benchmark's finished runs again, where the table lacks that.

    A stop loses those of one run a process.

    Parameters
    ----------
    place
        The folder of the runs; there may be none yet.

    Returns
    -------
    failures
        Why drawn grasps of some runs could not be evaluated; those of the others were.
    """
    failures: dict[Key, QdgraspError] = {}
    without_drawn = store.without_drawn(asked.benchmark)
    if stop.is_set or not without_drawn or not JobFolder.is_job(place):
        return failures
    folders = folders_by_key([place])
    left = {folders[one].path: one for one in sorted(without_drawn & folders.keys())}
    if not left:
        return failures
    for path, found in side_by_side(_drawn_or_error, left, processes):
        if isinstance(found, QdgraspError):
            failures[left[path]] = found
        else:
            store.put(left[path], found)
        if stop.is_set:
            break
    store.write_page()
    return failures


def _drawn_or_error(path: Path) -> Figures | QdgraspError:
    try:
        return drawn_figures(path)
    except QdgraspError as error:
        return error


def missing_assets(runs: Collection[Wanted]) -> dict[str, InputError]:
    """The hands and objects of runs that are not on this machine, each with its message.

    Those of the benchmark are made first.
    """
    checks: dict[str, Callable[[str], object]] = {one.spec.gripper: find_gripper for one in runs} | {
        one.spec.object: check_object for one in runs
    }
    found: dict[str, InputError] = {}
    for name, check in checks.items():
        try:
            if asset_name(name):
                make_asset(Path(name))
            check(name)
        except InputError as error:
            found[name] = error
    return found


def _add_finished(store: Store, place: Path) -> None:
    """Add the new rows of the runs in a folder."""
    if JobFolder.is_job(place):
        store.add([place], again=False)


def folders_by_key(directories: Iterable[Path]) -> dict[Key, RunFolder]:
    """The runs in folders by their keys."""
    return {key(folder.spec): folder for path in directories for folder in search_run_folders(path)}


def code_folder(home: Path) -> Path:
    """The folder below `home` for the runs of this code, of evaluation and search."""
    said = json.dumps(platform(), sort_keys=True).encode()
    digest = hashlib.sha256(said + _search_digest())
    return home / digest.hexdigest()[:NAME_DIGITS]


def _search_digest() -> bytes:
    """The sha256 over the sources of the searches, and of the modules that ask them."""
    here = Path(str(qdgrasp_coordinator.__file__)).parent
    sources = [*(here / f"{name}.py" for name in SEARCHING), *sorted(here.glob("search/*.py"))]
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).digest()


def run_stage(place: Path, stage: Sequence[Wanted], config: LocalJobConfig, stop: Stop) -> None:
    """Carry out a stage, and the unfinished runs of an earlier one.

    Raises
    ------
    InputError
        A run cannot be carried out; the others are.
    EndedEarly
        The coordinator died; the next stage goes on.
    """
    asked = extended_campaign(place, stage)
    extent = begin_campaign(place, asked)
    if extent.runs_done == extent.runs:
        return
    with progress_display("results", asked.evaluations) as shown:
        run_job(JobFolder(place), config, shown, stop)


def extended_campaign(place: Path, stage: Iterable[Wanted]) -> Campaign:
    """The campaign in a folder with a stage more; a run that is there already gets the greater budget."""
    known = read_campaign(place / CAMPAIGN, is_begun=True).runs if (place / CAMPAIGN).is_file() else {}
    runs: dict[str, RunSpec] = dict(known)
    for one in stage:
        if one.name not in runs or runs[one.name].evaluations < one.spec.evaluations:
            runs[one.name] = one.spec
    return make_campaign(campaign_source(runs.values()), str(place / CAMPAIGN), taken=())


def campaign_source(specs: Collection[RunSpec]) -> dict[str, Any]:
    """The content of a campaign's file that asks for these runs, by the names that they have.

    The mass of a made object is no part of a name, and so stands in a table of its own.
    """
    own = {spec.object: {"mass": spec.mass} for spec in specs if has_own_mass(spec)}
    runs = [
        {key: value for key, value in to_values(spec).items() if key != "mass" or spec.object not in own}
        for spec in specs
    ]
    return {"cross": runs, "objects": own}
