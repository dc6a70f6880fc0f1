"""Builds reference sets from runs, as the paper built its own.

Huber et al. 2024, section IV. The sets remember what each run found: from how many runs found each cell
follows an estimate of the cells that none did (metrics/richness.py).
"""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.ycb import PREFIX
from qdgrasp_coordinator.metrics.arrays import LARGEST_ARRAYS
from qdgrasp_coordinator.metrics.cells import best_per_cell, cell_keys, cells
from qdgrasp_coordinator.metrics.reference_coverage import (
    ReferenceOrigin,
    ReferenceSet,
    object_identity,
    read_references,
)
from qdgrasp_coordinator.metrics.run_stats import successes
from qdgrasp_coordinator.metrics.scores import survival
from qdgrasp_coordinator.storage import atomic_files, job_folder
from qdgrasp_coordinator.storage.outputs import OutFile
from qdgrasp_coordinator.storage.run_folder import RunFolder, provenances, run_digest
from qdgrasp_protocol.errors import AssetError, InputError
from qdgrasp_protocol.rows import GIVEN, Rows
from qdgrasp_protocol.text import quoted

SetsByObject = dict[str, ReferenceSet]
ReachedCells = tuple[NDArray[np.int64], NDArray[np.uint8]]  # Cells (n, 3) and the fitness in each (n,)
ARRAY_HEADER = 256  # Bytes of an array's header in a file, at most


def build_reference_sets(
    folders: Iterable[RunFolder], out: Path, name: str | None = None, *, mixed: bool = False
) -> SetsByObject:
    """Add the cells that runs found to the sets in a file, or make a new file.

    A cell gets the best fitness found there, as a whole and by run. A run that is added again, as it was or
    as it is later, counts once, with all that any record of it has. The file is replaced as a whole at the
    end, or left as it was. `name` is the object's in the file (None: that of each run's object, without
    `ycb_`); `mixed` lets runs under different evaluation protocols go into one set. Returns the sets of the
    runs' objects, by name, as they are in the file now.

    Raises AssetError if the file holds sets that do not say what they were built from, or which run found
    which cell; InputError for runs with another gripper, on another object or, unless `mixed`, under another
    protocol, or that score given poses, or if no run of an object has a success; FolderError if a run cannot
    be read, the file cannot be written, or another process is adding to it.
    """
    output = OutFile(out, force=True)  # what is in it stays in it
    output.check()
    _existing_sets(out)  # what cannot be added to is refused before anything is touched
    gathered: SetsByObject = {}
    for folder in folders:
        _add(gathered, reference_set_of(folder, name), folder.path, mixed)
    home = out.absolute().parent
    with (
        atomic_files.writing(out, output.instead),
        atomic_files.making_parents(home),
        job_folder.hold_lock(home, f".{out.name}.lock", is_removed=True),
    ):
        sets = _existing_sets(out)
        for key, found in gathered.items():
            _add(sets, found, out, mixed)
            if not len(sets[key]):
                reason = "no row of its runs is a success; leave them out"
                raise InputError(f"There is no cell for a set of '{key}': {reason}.")
        _write(output, sets)
    return {name: sets[name] for name in gathered}


def reference_set_of(folder: RunFolder, name: str | None = None) -> ReferenceSet:
    """Make the set of a run, or of the runs whose successes a folder keeps.

    It has the cells of their successes, the best fitness of each run there, and runs without a success too.
    """
    spec, scene = folder.spec, folder.scene()
    key = name or scene.object.name.removeprefix(PREFIX)
    origin = ReferenceOrigin(
        scene.gripper.name, Path(spec.object).name, object_identity(scene.object), (scene.protocol,)
    )
    none = np.zeros((0, 3), np.int64), np.zeros(0, np.uint8)
    made = ReferenceSet(key, *none, origin, np.zeros((0, 0), np.uint8))
    with folder.journal() as journal:
        for run in provenances(folder, journal):
            if run.spec.method == GIVEN:
                raise InputError(
                    f"{folder.path} scores given poses, which were found elsewhere; leave it out, and take "
                    "the runs that found them."
                )
            blocks = journal.kept(run.rows.start, run.rows.stop)
            reached, fitness = zip(none, *(_best_cells(successes(rows)) for rows in blocks), strict=True)
            distinct, best = best_per_cell(np.concatenate(reached), np.concatenate(fitness))
            its_own = replace(origin, runs=(run_digest(run.spec, journal, run.rows),))
            found = ReferenceSet(key, distinct, best, its_own, 1 + best[None])
            made = _joined(made, found, folder.path)
    return made


def merge_reference_sets(
    old: ReferenceSet, new: ReferenceSet, where: Path, *, mixed: bool = False
) -> ReferenceSet:
    """Join two sets of one object; errors name `where` the new runs are."""
    (known, _), (came, _) = _built_from(old, where), _built_from(new, where)
    if known.identity != came.identity:
        raise InputError(
            f"The runs of '{old.object}' are on different objects, '{known.object}' and '{came.object}', "
            f"whose mesh or centre of mass differs ({where}); give one of them another name with --name."
        )
    if not mixed and not set(came.protocols) <= set(known.protocols):
        raise InputError(
            f"The runs of '{old.object}' are under different evaluation protocols, "
            f"{_in_words(known.protocols)} and {_in_words(came.protocols)} ({where}); --mixed takes them all."
        )
    return _joined(old, new, where)


def _add(sets: SetsByObject, new: ReferenceSet, where: Path, mixed: bool) -> None:
    grippers = {origin.gripper for origin in (one.origin for one in (*sets.values(), new)) if origin}
    if len(grippers) > 1:
        raise InputError(
            "One file holds the sets of one gripper, and these runs are with "
            f"{_in_words(grippers)} ({where})."
        )
    old = sets.get(new.object)
    sets[new.object] = new if old is None else merge_reference_sets(old, new, where, mixed=mixed)


def _best_cells(found: Rows) -> ReachedCells:
    """Return the cells of nominal successes, and the best survival in each: 0, 1 or 2."""
    return best_per_cell(cells(found["base_to_object"][:, :3]), survival(found))


def _joined(old: ReferenceSet, new: ReferenceSet, where: Path) -> ReferenceSet:
    """Join two sets run by run: cells in lexicographic order, runs by their digests."""
    parts = [(one.cells, *_built_from(one, where)) for one in (old, new)]
    both, origins, _ = zip(*parts, strict=True)
    distinct = np.unique(np.concatenate(both), axis=0)
    runs = sorted({run for origin in origins for run in origin.runs})
    by_run = np.zeros((len(runs), len(distinct)), np.uint8)
    for reached, origin, best in parts:
        columns = np.searchsorted(cell_keys(distinct), cell_keys(reached))
        places = np.ix_(np.array([runs.index(run) for run in origin.runs], np.intp), columns)
        by_run[places] = np.maximum(by_run[places], best)
    protocols = sorted({name for origin in origins for name in origin.protocols})
    origin = replace(origins[0], protocols=tuple(protocols), runs=tuple(runs))
    return replace(old, cells=distinct, fitness=by_run.max(axis=0) - 1, origin=origin, by_run=by_run)


def _built_from(known: ReferenceSet, path: Path) -> tuple[ReferenceOrigin, NDArray[np.uint8]]:
    """Return what a set was built from, and what each run found; errors name its file."""
    if known.origin is None:
        raise AssetError(
            f"'{path}' does not say what its sets were built from, so that nothing can be added to it; "
            "name another file with --out."
        )
    if known.by_run is None:
        raise AssetError(
            f"'{path}' does not say which run found which cell, as earlier versions did not, so that nothing "
            "can be added to it; build it anew from its runs, into another file with --out."
        )
    return known.origin, known.by_run


def _existing_sets(out: Path) -> SetsByObject:
    sets = read_references(out) if out.exists() else {}
    for known in sets.values():
        _built_from(known, out)
    return sets


def _write(out: OutFile, sets: SetsByObject) -> None:
    arrays: dict[str, NDArray[np.generic]] = {}
    for name, known in sorted(sets.items()):
        origin, by_run = _built_from(known, out.path)
        arrays["gripper"] = np.array(origin.gripper)
        arrays[f"{name}.cm"] = known.cells.astype(np.int16)
        arrays[f"{name}.fitness"] = known.fitness
        arrays[f"{name}.made_with"] = np.array(origin.object)
        arrays[f"{name}.identity"] = np.array(origin.identity)
        arrays[f"{name}.protocols"] = np.array(origin.protocols)
        arrays[f"{name}.runs"] = np.array(origin.runs)
        arrays[f"{name}.by_run"] = by_run
    if (size := sum(array.nbytes + ARRAY_HEADER for array in arrays.values())) > LARGEST_ARRAYS:
        raise InputError(
            f"'{out.path}' would hold {size} bytes of arrays, and at most {LARGEST_ARRAYS >> 20} MiB are "
            "read; name another file with --out for some of its objects."
        )
    with out.writing() as made, made.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def _in_words(names: Iterable[str]) -> str:
    return " and ".join(quoted(sorted(names)))
