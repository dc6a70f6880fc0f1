"""Builds reference sets from runs, as the paper built its own.

Huber et al. 2024, section IV.
"""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.cells import best_per_cell, cells
from qdgrasp_coordinator.metrics.reference_coverage import (
    SCAN_PREFIX,
    ReferenceOrigin,
    ReferenceSet,
    object_identity,
    read_references,
)
from qdgrasp_coordinator.metrics.run_stats import successes
from qdgrasp_coordinator.storage import atomic_files, job_folder
from qdgrasp_coordinator.storage.outputs import OutFile
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import AssetError, InputError
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.text import quoted

SetsByObject = dict[str, ReferenceSet]
ReachedCells = tuple[NDArray[np.int64], NDArray[np.uint8]]  # Cells (n, 3) and the fitness in each (n,)


def build_reference_sets(
    folders: Iterable[RunFolder], out: Path, name: str | None = None, *, mixed: bool = False
) -> SetsByObject:
    """Add the cells that runs found to the sets in a file, or make a new file.

    A cell gets the best fitness found there. Adding a run again changes nothing. The file is replaced as a
    whole at the end, or left as it was. `name` is the object's in the file (None: that of each run's object,
    without `ycb_`); `mixed` lets runs under different evaluation protocols go into one set. Returns the sets
    of the runs' objects, by name, as they are in the file now.

    Raises AssetError if the file holds sets that do not say what they were built from; InputError for runs
    with another gripper, on another object or, unless `mixed`, under another protocol, or if no run of an
    object has a success; FolderError if a run cannot be read, the file cannot be written, or another process
    is adding to it.
    """
    output = OutFile(out, force=True)  # what is in it stays in it
    output.check()
    _existing_sets(out)  # what cannot be added to is refused before anything is touched
    gathered: SetsByObject = {}
    for folder in folders:
        _add(gathered, reference_set_of(folder, name), folder.path, mixed)
    for key, found in gathered.items():
        if not len(found):
            reason = "no row of its runs is a success; leave them out"
            raise InputError(f"There is no cell for a set of '{key}': {reason}.")
    home = out.absolute().parent
    with (
        atomic_files.writing(out, output.instead),
        atomic_files.making_parents(home),
        job_folder.hold_lock(home, f".{out.name}.lock", is_removed=True),
    ):
        sets = _existing_sets(out)
        for found in gathered.values():
            _add(sets, found, out, mixed)
        _write(output, sets)
    return {name: sets[name] for name in gathered}


def reference_set_of(folder: RunFolder, name: str | None = None) -> ReferenceSet:
    """Make the set of a run: the cells of its successes with the best fitness in each."""
    spec, scene = folder.spec, folder.scene()
    key = name or scene.object.name.removeprefix(SCAN_PREFIX)
    origin = ReferenceOrigin(
        scene.gripper.name, Path(spec.object).name, object_identity(scene.object), (scene.protocol,)
    )
    empty = ReferenceSet(key, np.zeros((0, 3), np.int64), np.zeros(0, np.uint8), origin)
    with folder.journal() as journal:
        found = [_best_cells(successes(rows)) for rows in journal.kept()]
    return _with_cells(empty, found)


def merge_reference_sets(
    old: ReferenceSet, new: ReferenceSet, where: Path, *, mixed: bool = False
) -> ReferenceSet:
    """Join two sets of one object; errors name `where` the new runs are."""
    known, came = _origin(old, where), _origin(new, where)
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
    protocols = tuple(sorted({*known.protocols, *came.protocols}))
    return replace(_with_cells(old, [(new.cells, new.fitness)]), origin=replace(known, protocols=protocols))


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
    positions = found["base_to_object"][:, :3]
    return best_per_cell(cells(positions), found["outcome"] - np.uint8(Outcome.DROPPED))


def _with_cells(old: ReferenceSet, found: Iterable[ReachedCells]) -> ReferenceSet:
    """Add cells to a set, each once with its best fitness, in lexicographic order."""
    reached, fitness = zip((old.cells, old.fitness), *found, strict=True)
    distinct, greatest = best_per_cell(np.concatenate(reached), np.concatenate(fitness))
    return replace(old, cells=distinct, fitness=greatest)


def _origin(known: ReferenceSet, path: Path) -> ReferenceOrigin:
    if known.origin is None:
        raise AssetError(
            f"'{path}' does not say what its sets were built from, so that nothing can be added to it; "
            "name another file with --out."
        )
    return known.origin


def _existing_sets(out: Path) -> SetsByObject:
    sets = read_references(out) if out.exists() else {}
    for known in sets.values():
        _origin(known, out)
    return sets


def _write(out: OutFile, sets: SetsByObject) -> None:
    arrays: dict[str, NDArray[np.generic]] = {}
    for name, known in sorted(sets.items()):
        origin = _origin(known, out.path)
        arrays["gripper"] = np.array(origin.gripper)
        arrays[f"{name}.cm"] = known.cells.astype(np.int16)
        arrays[f"{name}.fitness"] = known.fitness
        arrays[f"{name}.made_with"] = np.array(origin.object)
        arrays[f"{name}.identity"] = np.array(origin.identity)
        arrays[f"{name}.protocols"] = np.array(origin.protocols)
    with out.writing() as made, made.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def _in_words(names: Iterable[str]) -> str:
    return " and ".join(quoted(sorted(names)))
