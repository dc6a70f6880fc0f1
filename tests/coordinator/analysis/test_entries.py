from pathlib import Path

import pytest
from tests.coordinator.analysis.runs import climb, made
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import SceneMaker

from qdgrasp_coordinator.analysis.entries import entries, histories, run_folders, usual
from qdgrasp_coordinator.analysis.target import Targets
from qdgrasp_coordinator.searches.search import METHODS
from qdgrasp_protocol.errors import FolderError


def test_runs_that_differ_in_their_seed_alone_are_one_entry() -> None:
    found = entries([made("me_scs", climb(1), seed=seed) for seed in (2, 0, 1)])
    assert [[run.spec.seed for run in entry.runs] for entry in found] == [[0, 1, 2]]
    assert found[0].name == "me_scs"


def test_hands_stand_in_the_paper_s_order_and_methods_in_that_of_the_table() -> None:
    runs = [
        made(method, climb(1), gripper=hand, object=thing)
        for hand in ("shadow", "panda", "own", "ref_bh280")
        for thing in ("mug", "bowl")
        for method in ("me_scs", "contact_rand")
    ]
    found = entries(runs)
    assert list(dict.fromkeys(entry.scene.gripper for entry in found)) == [
        "panda",
        "ref_bh280",
        "shadow",
        "own",
    ]
    assert [(entry.scene.object, entry.method) for entry in found[:4]] == [
        ("bowl", "contact_rand"), ("bowl", "me_scs"), ("mug", "contact_rand"), ("mug", "me_scs"),
    ]  # fmt: skip


def test_settings_that_differ_within_a_method_tell_its_variants_apart() -> None:
    runs = [
        made("me_scs", climb(1), seed=seed, mutation_sigma=sigma) for seed in (0, 1) for sigma in (0.3, 0.05)
    ]
    other = made("cma_mae", climb(1), population=540)
    found = entries([*runs, other])
    assert [(entry.name, len(entry.runs)) for entry in found] == [
        ("me_scs mutation sigma 0.05", 2), ("me_scs mutation sigma 0.3", 2), ("cma_mae", 1),
    ]  # fmt: skip


def test_the_usual_variant_of_a_method_is_the_one_nearest_to_the_defaults() -> None:
    runs = [made("me_scs", climb(1), mutation_sigma=sigma, population=60) for sigma in (0.02, 0.1, 0.4)]
    (by_method,) = usual(entries(runs)).values()
    assert by_method["me_scs"].runs[0].spec.mutation_sigma == 0.1


@pytest.mark.parametrize(("method", "counting"), [("aimed", "redraw"), ("me_scs", "count")])
def test_the_usual_variant_counts_as_its_method_does(method: str, counting: str) -> None:
    population = METHODS[method].population
    runs = [
        made(method, climb(1), overlaps=overlaps, population=population) for overlaps in ("count", "redraw")
    ]
    (by_method,) = usual(entries(runs)).values()
    assert by_method[method].overlaps == counting


def test_protocols_are_scenes_of_their_own() -> None:
    found = entries([made("me_scs", climb(1), protocol=name) for name in ("paper", "released")])
    assert [entry.scene.words for entry in found] == ["jaw on block", "jaw on block (released)"]


def test_an_unfinished_run_settles_nothing_beside_finished_ones() -> None:
    finished, going = made("me_scs", climb(1)), made("me_scs", climb(1), seed=1, evaluations=10)
    waiting = made("me_scs", climb(), seed=2, evaluations=0)
    (entry,) = entries([finished, going, waiting])
    assert (entry.unfinished, entry.settled) == (2, (finished,))
    (alone,) = entries([going, waiting])
    assert alone.settled == (going,)


@pytest.mark.parametrize("home", ["runs", "."])
def test_runs_are_found_in_a_campaign_and_side_by_side(
    tmp_path: Path, make_scene: SceneMaker, home: str
) -> None:
    (tmp_path / home).mkdir(exist_ok=True)
    (tmp_path / home / "analysis").mkdir()
    for name in ("b", "a"):
        record(tmp_path / home / name, make_scene(), random_rows(20))
    assert [folder.path.name for folder in run_folders(tmp_path)] == ["a", "b"]
    assert [folder.path.name for folder in run_folders(tmp_path / home / "a")] == ["a"]


def test_a_run_without_the_files_of_its_job_is_one_all_the_same(
    tmp_path: Path, make_scene: SceneMaker
) -> None:
    folder = record(tmp_path / "a", make_scene(), random_rows(20))
    (folder.path / "job.json").unlink()
    (found,) = histories(run_folders(tmp_path), Targets())
    assert found.evaluations == 20


def test_runs_that_score_given_poses_are_passed_over(tmp_path: Path, make_scene: SceneMaker) -> None:
    pose = (0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0)
    scored = record(tmp_path / "scored", make_scene(), random_rows(1), method="given", poses=(pose,))
    with pytest.raises(FolderError, match="score given poses"):
        run_folders(scored.path)
    record(tmp_path / "searched", make_scene(), random_rows(20))
    assert [folder.path.name for folder in run_folders(tmp_path)] == ["searched"]


def test_a_folder_without_runs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FolderError, match="holds no runs: expected run folders in"):
        run_folders(tmp_path)
    with pytest.raises(FolderError, match="There is no folder"):
        run_folders(tmp_path / "nowhere")


def test_a_run_whose_scene_is_elsewhere_has_no_target(tmp_path: Path, make_scene: SceneMaker) -> None:
    folder = record(tmp_path / "a", make_scene(), random_rows(20))
    (folder.path / "scene.bundle").unlink()
    (found,) = histories([folder], Targets())
    assert (found.target.size, found.target.why) == (0, "the run's scene is not here")
    assert found.evaluations == 20
