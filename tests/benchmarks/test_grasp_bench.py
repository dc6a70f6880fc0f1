"""The frozen benchmark: its objects have the same bits everywhere, and its table compares what it says."""

from pathlib import Path

import numpy as np
import pytest
from benchmarks import grasp_bench
from benchmarks.grasp_bench import Arm, log_ratios
from benchmarks.grasp_bench_assets import OBJECTS, make_asset

from qdgrasp_protocol.errors import InputError
from qdgrasp_tools.campaign.campaign_file import read_campaign


def arm(method: str, *cells: str) -> Arm:
    rows = tuple({"cells_that_hold": number, "after_5s": number, "cpu_seconds": "6"} for number in cells)
    return Arm(method, ("panda", "mug"), rows)


@pytest.mark.parametrize("name", OBJECTS)
def test_an_object_has_the_bits_of_the_benchmark(name: str, tmp_path: Path) -> None:
    make_asset(tmp_path / f"{name}.stl")  # raises InputError for another digest
    assert (tmp_path / f"{name}.stl").read_bytes() == OBJECTS[name].file


def test_an_object_that_is_made_otherwise_here_is_refused(tmp_path: Path, monkeypatch) -> None:
    made = OBJECTS["knob"]
    monkeypatch.setitem(OBJECTS, "knob", type(made)(OBJECTS["ring"].build, made.mass, made.sha256))
    with pytest.raises(InputError, match="otherwise here"):
        make_asset(tmp_path / "knob.stl")


def test_every_run_that_is_in_is_one_that_the_campaigns_ask_for() -> None:
    asked = {
        grasp_bench.key(spec)
        for file in grasp_bench.CAMPAIGNS
        for spec in read_campaign(file, here=False).runs.values()
    }
    assert grasp_bench.read_table().keys() <= asked


def test_the_best_other_is_chosen_for_each_scene_and_a_scene_without_that_work_is_left_out() -> None:
    scenes = [
        {"aimed": arm("aimed", "19", "19"), "a": arm("a", "9", "9"), "b": arm("b", "4", "4")},
        {"aimed": arm("aimed", "9", "9"), "a": arm("a", "4", "4"), "b": arm("b", "19", "19")},
        {"aimed": arm("aimed", "9", ""), "a": arm("a", "4", "4")},
    ]
    ratios, behind = log_ratios(scenes, None, "5s")
    assert np.exp(ratios).tolist() == pytest.approx([2, 0.5])
    assert behind == 1
    assert np.exp(log_ratios(scenes, "b", "5s")[0]).tolist() == pytest.approx([4, 0.5])
