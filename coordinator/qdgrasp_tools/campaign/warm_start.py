"""Warm start: weights that a new run begins with, learned by others of the same hand.

The weights give the value of candidates and of cells by their features; cells themselves are not handed on,
as they belong to an object. Weights are learned from journals, by replaying them into their searches.
"""

from collections.abc import Iterable, Sequence

import msgspec
import numpy as np
from msgspec import Struct

from qdgrasp_assets.catalog import find_gripper
from qdgrasp_assets.genes import STEEPEST_VALUE
from qdgrasp_coordinator.scheduler.run_plan import plan_run
from qdgrasp_coordinator.search.base import search_space
from qdgrasp_coordinator.search.registry import learns_value, prior_of, search_words
from qdgrasp_coordinator.search.success_model import STARTS, pooled_weights
from qdgrasp_coordinator.search.value_search import ValueSearch
from qdgrasp_coordinator.storage import outputs
from qdgrasp_coordinator.storage.outputs import ORIGIN
from qdgrasp_coordinator.storage.run_folder import PreparedScene, RunFolder
from qdgrasp_protocol.errors import InputError, ReplayError
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import FirstWeights, RunSpec

SAME_KEYS = ("aim_for", "nominal_protocol", "overlaps")
"""Keys of a spec that must be the same, so that touch and quality mean the same."""


class WarmStartRun(Struct, frozen=True):
    """A run whose journal weights were learned from."""

    run: str
    """Its folder."""
    rows: int
    """Rows that were in its journal then."""


class WarmStart(Struct, frozen=True):
    """Weights for a new run, and where they come from."""

    weights: FirstWeights
    runs: tuple[WarmStartRun, ...]

    @classmethod
    def learned(cls, spec: RunSpec, folders: Sequence[RunFolder]) -> "WarmStart":
        """Learn the weights that a run of `spec` begins with from other runs.

        Raises InputError where one is of another hand, or its search learned something else, or has no whole
        journal, or where all of them found too little; `FolderError` where a journal cannot be read.
        """
        if not learns_value(spec):
            raise InputError(
                "A warm start is for the method 'aimed' that aims for hold, eta or margin, by position, and "
                f"{search_words(spec)} learns no such value; leave --warm-start out."
            )
        for folder in folders:
            _check_alike(spec, folder)
        replayed = [_replayed(folder) for folder in folders]
        weights = learned_weights([search for search, _ in replayed])
        if weights == FirstWeights():
            raise InputError(
                f"{', '.join(str(folder.path) for folder in folders)} found too few successes or failures to "
                "learn from; go on with a run, or name others."
            )
        return cls(weights, tuple(origin for _, origin in replayed))

    def write(self, folder: RunFolder) -> None:
        """Note in the new run's folder which runs its weights were learned from."""
        outputs.replace(folder.path / ORIGIN, msgspec.json.encode({"runs": self.runs}))


def learned_weights(searches: Sequence[ValueSearch]) -> FirstWeights:
    """Return weights by what searches were told; None where that is too little."""
    return FirstWeights(**{name: _pooled(name, searches) for name in STARTS})


def replayed_search(spec: RunSpec, prepared: PreparedScene, blocks: Iterable[Rows]) -> ValueSearch:
    """Return a run's search, told its journal; raise ReplayError where it did not ask that."""
    search = ValueSearch(spec, search_space(prepared.scene, prior_of(spec)))
    plan = plan_run(spec, prepared, search=search)
    for rows in blocks:
        plan.pipeline.replay(rows)
    return search


def _check_alike(spec: RunSpec, folder: RunFolder) -> None:
    """Check that what a run learned means the same in a run of `spec`."""
    source = folder.spec
    if not learns_value(source):
        raise InputError(
            f"{folder.path} has learned no value that could be handed on: it is a run of "
            f"{search_words(source)}; name runs of 'aimed' that aim for {spec.aim_for} by position."
        )
    for key in SAME_KEYS:
        mine, its = getattr(spec, key), getattr(source, key)
        if mine != its:
            raise InputError(
                f"{folder.path} has {key.replace('nominal_', '')} '{its}' and this run '{mine}', so that it "
                "learned another value; name runs that agree in it."
            )
    hand, its_hand = find_gripper(spec.gripper).on_carrier(spec.nominal_protocol), folder.scene().gripper
    if hand != its_hand:
        raise InputError(
            f"{folder.path} is a run of the hand '{its_hand.name}' as its files were then, and this one is "
            f"of '{hand.name}' as they are: what was learned of one hand is not handed on to another."
        )


def _replayed(folder: RunFolder) -> tuple[ValueSearch, WarmStartRun]:
    try:
        with folder.journal() as journal:
            origin = WarmStartRun(str(folder.path.absolute()), journal.count)
            return replayed_search(folder.spec, folder.prepared_scene(), journal.blocks()), origin
    except ReplayError as error:
        raise InputError(f"{folder.path} cannot be learned from: {error}") from None


def _pooled(name: str, searches: Sequence[ValueSearch]) -> tuple[float, ...] | None:
    """Return weights of a model by the examples of all, as far as genes can hold them."""
    weights = pooled_weights([search.models[name] for search in searches], STARTS[name])
    if weights is None:
        return None
    return tuple(np.clip(weights, -STEEPEST_VALUE, STEEPEST_VALUE).tolist())
