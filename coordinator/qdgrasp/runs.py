"""Reads a run, its grasps and every row of its journal; and the runs of a campaign."""

import os
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from qdgrasp.hand import Hand
from qdgrasp_assets.genes import archive_box, layout
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics.grasp_quality import GraspLimits
from qdgrasp_coordinator.search.paper_searches import ribs_archive
from qdgrasp_coordinator.search.registry import prior_of
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import check_packages
from qdgrasp_protocol.rows import Layout, Outcome, Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.campaign.campaign_folder import open_campaign
from qdgrasp_tools.export.grasp_reader import ALL_FAILURES, GraspChoice, choose_grasps, read_run
from qdgrasp_tools.export.grasp_set import Grasps
from qdgrasp_tools.export.grasp_table import arrow_table, frame_of
from qdgrasp_tools.report.run_report import RunSummary, run_summary

SAMPLE_ROWS = 8192  # Grasps that are made into a table of Arrow at once


class Run:
    """A run's folder, for reading; each call returns what is recorded by then.

    `path` is the folder; of a campaign, that of one of its runs. Raises FolderError if it holds no run.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._folder = RunFolder.open(self.path)

    def __repr__(self) -> str:
        return f"qdgrasp.open({str(self.path)!r})"

    @property
    def spec(self) -> RunSpec:
        """Its spec: gripper, object, method, protocol, seed, budget."""
        return self._folder.spec

    @cached_property
    def scene(self) -> Scene:
        """The gripper and the object as they are simulated; lengths in m, masses in kg."""
        return self._folder.scene()

    @property
    def hand(self) -> Hand:
        """The gripper of its scene."""
        return Hand(self.scene.gripper)

    @property
    def layout(self) -> Layout:
        """The genes of its genomes: names, and what -1 and 1 stand for."""
        return layout(self.scene, prior_of(self.spec))

    @property
    def summary(self) -> RunSummary:
        """The figures that `qdgrasp info` prints, counted from the journal."""
        return run_summary(self._folder)

    def grasps(
        self,
        *,
        min_fitness: float | None = None,
        top: int | None = None,
        diverse: int | None = None,
        max_penetration: float | None = None,
        max_motion: float | None = None,
        min_margin: float | None = None,
        min_links: int | None = None,
        holds_in: str | None = None,
        approach_distance: float | None = None,
        resting_pose: int | Literal["any"] | None = None,
        failures: bool = False,
    ) -> Grasps:
        """Return the grasps found so far, as arrays.

        Parameters
        ----------
        min_fitness
            Least number of disturbances survived: 1 for grasps, 0 for all successes. None: grasps that
            survived all, under `physical`, also as the base of `robust`; else 1.
        top
            At most so many, best first.
        diverse
            At most so many, well spread over positions and orientations, the best one first.
        max_penetration, max_motion
            Deepest penetration after closing [mm]; way of the object in the hand while it closed [mm].
        min_margin, min_links
            Least Ferrari-Canny margin; least number of finger links that touch.
        holds_in
            Those alone that hold in this engine, "bullet" or "mujoco", by the table that `qdgrasp verify DIR
            --engine` wrote; grasps that it does not know are left out (`Grasps.elsewhere` tells). Of a run in
            two engines those that hold in both.
        approach_distance, resting_pose
            Those alone that the open hand comes to from this distance [m] along its approach axis, touching
            nothing, and above a table that the object rests on in this pose, or "any"; as the run was asked
            unless one is given. `Grasps.reach` tells how.
        failures
            After the grasps also every simulated pose that is none, in journal order. Poses that overlap the
            object are in `rows` alone.

        Returns
        -------
        grasps
            Of n grasps `poses(frame)` (n, 7) with `pregrasp` (n, j), before closing; `settled_poses(frame)`
            (n, 7) with `joints` (n, j), after it; `fitness` (n,), `eta` (n,), `rows` (n,) and more; iterating
            gives one `Grasp` after the other. Frames are "mesh", that of the object's mesh file in m, and
            "com", that of its centre of mass. In journal order unless `top` or `diverse` is given.

        Examples
        --------
        >>> for grasp in qdgrasp.open("runs/mug").grasps(diverse=10):
        ...     print(grasp.number, grasp.settled_position, grasp.settled_quaternion_xyzw, grasp.joints)
        """
        limits = GraspLimits(max_penetration, max_motion, min_margin, min_links)
        found = read_run(self._folder, Outcome.MISSED if failures else Outcome.DROPPED)
        choice = GraspChoice(
            min_fitness=min_fitness,
            top=top,
            diverse=diverse,
            limits=limits,
            holds_in=holds_in,
            approach_distance=approach_distance,
            resting_pose=resting_pose,
        )
        return choose_grasps(found, choice, ALL_FAILURES if failures else 0).grasps

    def tables(self, *, min_fitness: int | None = None, frame: str = "mesh") -> Iterator[Any]:
        """Yield the grasps as tables of pyarrow, some thousands at a time.

        The columns are those of `qdgrasp export --format parquet`, with poses in the object's `frame`,
        and `min_fitness` is that of `grasps`. It needs the extra `qdgrasp[export]`.
        """
        check_packages("Run.tables", "pyarrow")
        grasps = choose_grasps(read_run(self._folder), GraspChoice(min_fitness)).grasps
        for first in range(0, len(grasps), SAMPLE_ROWS):
            yield arrow_table(grasps[first : first + SAMPLE_ROWS].all_columns(frame_of(frame)))

    def rows(self) -> Rows:
        """Return every row of the journal (n,), failures and trials too, as a structured array.

        The columns stand in docs/run-folder.md.
        """
        parts = list(self.blocks())
        if parts:
            return np.concatenate(parts)
        with self._folder.journal() as journal:
            return journal.shape.empty(0)

    def blocks(self) -> Iterator[Rows]:
        """Yield the same rows some thousands at a time, for runs that do not fit into memory."""
        with self._folder.journal() as journal:
            yield from journal.blocks()

    def archive(self) -> Any:
        """Return the successes as a `ribs.archives.GridArchive`, the best of each 1 cm cell.

        Solutions are genomes, measures hand positions [m] in the frame of the centre of mass, objectives the
        fitness that the search is told. `archive.data(return_type="pandas")` is its table, and
        `ribs.visualize` draws it.
        """
        rows = self._folder.successes().scored
        box = archive_box(self.scene, prior_of(self.spec))
        return ribs_archive(box, rows, rows["fitness"].astype(np.float64))


FIGURES = (
    *("gripper", "object", "method", "protocol", "engine", "seed", "evaluations", "budget", "successes"),
    *("cells", "grasps", "robust", "success_share", "complete"),
)
"""The key figures of a run, by the names that `RunSummary` explains."""


class CampaignRuns:
    """The runs of a campaign's folder, for reading: iterated by object and hand, one at a time.

    Only the names of the runs are in memory. Raises FolderError if the folder holds no campaign.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._folder = open_campaign(self.path)

    def __repr__(self) -> str:
        return f"qdgrasp.open({str(self.path)!r})"

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names of its runs, sorted by object, hand and name."""
        found = []
        for path in filter(RunFolder.is_run, self._folder.run_paths):
            spec = RunFolder(path).spec
            found.append((Path(spec.object).stem, Path(spec.gripper).stem, path.name))
        return tuple(name for *_, name in sorted(found))

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Run]:
        return map(self.__getitem__, self.names)

    def __getitem__(self, name: str) -> Run:
        """Return the run of a name; raises FolderError without one."""
        return Run(self._folder.run_path(name))

    def to_pandas(self) -> Any:
        """Return the key figures of every run as a `pandas.DataFrame`, a line each, by its name.

        Every journal is counted, which takes a while for thousands of runs. Raises InputError without pandas.
        """
        check_packages("to_pandas()", "pandas")
        import pandas as pd  # takes its time to load

        lines = [{name: getattr(run.summary, name) for name in FIGURES} for run in self]
        return pd.DataFrame(lines, index=pd.Index(self.names, name="run"), columns=list(FIGURES))


def open(path: str | os.PathLike[str]) -> Any:  # noqa: A001  # said as qdgrasp.open
    """Open a folder to read: of a run `Run`, of a campaign `CampaignRuns`; raises as these.

    Examples
    --------
    >>> run = qdgrasp.open("runs/mug")
    >>> run.summary.robust, run.grasps().poses("mesh").shape
    (214, (214, 7))
    >>> for run in qdgrasp.open("runs/campaign"):
    ...     for table in run.tables():
    ...         print(run.spec.object, run.spec.gripper, table.num_rows)
    """
    folder = Path(path)
    return CampaignRuns(folder) if JobFolder.is_job(folder) and JobFolder(folder).is_campaign else Run(folder)
