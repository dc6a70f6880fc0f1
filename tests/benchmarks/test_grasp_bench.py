"""The frozen benchmark: its objects have the same bits everywhere, and its table compares what it says."""

from pathlib import Path

import numpy as np
import pytest
from benchmarks import grasp_bench
from benchmarks.grasp_bench import ratio
from benchmarks.grasp_bench_assets import OBJECTS, make_asset

from qdgrasp_protocol.errors import InputError


@pytest.mark.parametrize("name", OBJECTS)
def test_an_object_has_the_bits_of_the_benchmark(name: str, tmp_path: Path) -> None:
    make_asset(tmp_path / f"{name}.stl")  # raises InputError for another digest
    assert (tmp_path / f"{name}.stl").read_bytes() == OBJECTS[name].file


def test_an_object_that_is_made_otherwise_here_is_refused(tmp_path: Path, monkeypatch) -> None:
    made = OBJECTS["knob"]
    monkeypatch.setitem(OBJECTS, "knob", type(made)(OBJECTS["ring"].build, made.mass, made.sha256))
    with pytest.raises(InputError, match="otherwise here"):
        make_asset(tmp_path / "knob.stl")


def row(method: str, seed: int, cells: int) -> dict[str, str]:
    return {"method": method, "seed": str(seed), "cells_15s": str(cells)}


def test_the_default_is_compared_with_the_best_other_by_medians_over_seeds() -> None:
    rows = [row("portfolio", 1, 19), row("portfolio", 2, 19), row("a", 1, 4), row("a", 2, 14), row("b", 1, 4)]
    assert ratio(rows, "cells_15s") == pytest.approx(2)
    assert ratio(rows, "cells_15s", "b") == pytest.approx(4)
    assert np.isnan(ratio(rows[2:], "cells_15s"))


def test_a_race_lets_each_method_of_the_hand_find_something(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setattr(grasp_bench, "SECONDS", (0.5,))
    few = {name: grasp_bench.PLAN["methods"][name] for name in ("portfolio", "antipodal_rand")}
    monkeypatch.setitem(grasp_bench.PLAN, "methods", few)
    found = {line["method"]: line for line in grasp_bench.race("barrett", "tennis_ball", 1, tmp_path)}
    assert not any(name.startswith("antipodal") for name in found)
    assert int(found["portfolio"]["evaluations"]) > 0
