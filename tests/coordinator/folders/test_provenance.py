"""Which run a row comes from: the only one, or one of those that were merged."""

from pathlib import Path

import numpy as np
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import SceneMaker

from qdgrasp_coordinator.counts.tally import successes
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.provenance import provenance, provenances
from qdgrasp_coordinator.keeping.merging import merge


def run(path: Path, scene_maker: SceneMaker, seed: int) -> RunFolder:
    return record(path, scene_maker(), random_rows(100, seed=seed), evaluations=100, seed=seed)


def test_the_rows_of_a_run_are_its_own(tmp_path: Path, make_scene: SceneMaker) -> None:
    folder = run(tmp_path / "one", make_scene, 0)
    with folder.journal() as journal:
        (only,) = provenances(folder, journal)
        assert provenance(folder, journal, 99) == only
    assert (only.run, only.rows, only.spec) == ("one", range(100), folder.spec)


def test_the_rows_of_a_merged_folder_are_those_of_its_runs(tmp_path: Path, make_scene: SceneMaker) -> None:
    folders = [run(tmp_path / f"s{seed}", make_scene, seed) for seed in (0, 1)]
    merge(folders, tmp_path / "both")
    merged = RunFolder.open(tmp_path / "both")
    with merged.journal() as journal:
        found = provenances(merged, journal)
        assert [one.run for one in found] == ["s0", "s1"]
        assert found[-1].rows.stop == journal.count
        for one, folder in zip(found, folders, strict=True):
            assert one.spec == folder.spec
            with folder.journal() as whole:
                expected = np.concatenate([successes(rows) for rows in whole.kept()])
            rows = np.concatenate(list(journal.kept(one.rows.start, one.rows.stop)))
            assert rows.tobytes() == expected.tobytes()
            assert provenance(merged, journal, one.rows.start) == one
