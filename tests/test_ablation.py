"""The measurement of what each part of the search that aims brings."""

import json

import pytest
from tests.benchmarks import ablation, alone

VALUES = {"gripper": "panda", "evaluations": 60, "overlaps": "redraw", "protocol": "paper"}


def measured(path, names):
    return ablation.measure(["tennis_ball"], [0], names, False, ablation.Finished(path), **VALUES)


@pytest.mark.parametrize("name", ablation.VARIANTS)
def test_a_search_without_a_part_still_finds_grasps(name, tmp_path):
    (run,) = measured(tmp_path / "runs", [name])
    assert run["evaluations"] == [60]
    assert run["successes"] > 0


def test_what_is_in_is_not_carried_out_again(tmp_path, monkeypatch):
    once = measured(tmp_path / "runs", ["aimed"])
    monkeypatch.setattr(alone, "run", None)
    assert json.dumps(measured(tmp_path / "runs", ["aimed"])) == json.dumps(once)  # NaN equals itself in text
    with pytest.raises(TypeError):
        measured(tmp_path / "runs", ["aimed", "no gate"])
