"""Legends: which synergy closed the hand, and what the trials of a success come to."""

from pathlib import Path

import numpy as np
from msgspec.structs import replace
from tests.coordinator.recorded_runs import record

from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import Scene, Synergy
from qdgrasp_coordinator.analysis.legends import Legends, legend
from qdgrasp_coordinator.counts.niches import synergies
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.keeping.merging import merge
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows, Shape

PRIORS = {"me_scs": "spherical", "contact_rand": "contact"}


def closing(make_scene) -> Scene:
    scene = make_scene()
    hand = replace(
        scene.gripper, synergies=tuple(Synergy(name=name, joints=("left",)) for name in ("a", "b", "c"))
    )
    return replace(scene, gripper=hand)


def run_of(path: Path, scene: Scene, method: str, seed: int) -> tuple[RunFolder, Rows]:
    random, genes = np.random.default_rng(seed), len(layout(scene, PRIORS[method]))
    rows = Shape(genes, 2).empty(20)
    rows["generation"], rows["index"] = np.divmod(np.arange(20), 10)
    rows["outcome"], rows["fitness"] = Outcome.HELD, 2
    rows["genome"] = random.uniform(-1, 1, rows["genome"].shape)
    rows["base_to_object"][:, :3] = rows["descriptor"] = random.uniform(-0.1, 0.1, (20, 3))
    rows["base_to_object"][:, 6] = 1
    return record(path, scene, rows, method=method, seed=seed, evaluations=20), rows


def labels(folder: RunFolder) -> list[int]:
    with folder.journal() as journal:
        rows = np.concatenate(list(journal.kept()))
        return legend(folder, journal).synergies(rows, np.arange(len(rows))).tolist()


def test_a_run_names_synergies_as_its_prior_does(tmp_path: Path, make_scene) -> None:
    scene = closing(make_scene)
    folder, rows = run_of(tmp_path / "mug", scene, "me_scs", 1)
    assert labels(folder) == synergies(scene, "spherical").labels(rows["genome"]).tolist()
    assert len(set(labels(folder))) == 3


def test_in_a_merged_journal_each_part_is_read_as_its_own_prior_does(tmp_path: Path, make_scene) -> None:
    scene = closing(make_scene)
    runs = [run_of(tmp_path / name, scene, name, seed) for seed, name in enumerate(PRIORS)]
    merge([folder for folder, _ in runs], tmp_path / "both")
    merged = RunFolder.open(tmp_path / "both")
    own = {name: labels(folder) for name, (folder, _) in zip(PRIORS, runs, strict=True)}
    with merged.journal() as journal:
        order = [source.asked.method for source in journal.sources]
    assert set(order) == set(PRIORS)
    assert labels(merged) == own[order[0]] + own[order[1]]


def test_a_legend_is_read_once(tmp_path: Path, make_scene) -> None:
    folder, _ = run_of(tmp_path / "mug", closing(make_scene), "me_scs", 1)
    known = Legends()
    with folder.journal() as journal:
        assert known.of(folder, journal) is known.of(folder, journal)


def test_before_the_scene_is_there_no_synergy_is_named(tmp_path: Path, make_scene) -> None:
    folder, rows = run_of(tmp_path / "mug", closing(make_scene), "me_scs", 1)
    (folder.path / "scene.bundle").unlink()
    with folder.journal() as journal:
        found = Legends().of(folder, journal).synergies(rows, np.arange(len(rows)))
    assert set(found.tolist()) == {-1}
