"""Weights that a new run begins with: learned from journals of runs of the same hand."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from tests.coordinator.recorded_runs import record_spec
from tests.coordinator.scenes import jaw, made_scene
from tests.coordinator.search.synthetic_scene import evaluate, shape, space
from typer.testing import CliRunner

from qdgrasp_assets.genes import STEEPEST_VALUE
from qdgrasp_assets.scene import pack_scene
from qdgrasp_coordinator.scheduler import run_plan
from qdgrasp_coordinator.scheduler.pipeline import Pipeline
from qdgrasp_coordinator.search.registry import check_spec
from qdgrasp_coordinator.search.success_model import STARTS, pooled_weights
from qdgrasp_coordinator.search.value_search import ValueSearch
from qdgrasp_coordinator.storage.outputs import ORIGIN
from qdgrasp_coordinator.storage.run_folder import PreparedScene, RunFolder
from qdgrasp_protocol.errors import FolderError, InputError
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.campaign import source_runs
from qdgrasp_tools.campaign.source_runs import WarmStart
from qdgrasp_tools.cli.main import app

SPACE = space("valued")
SPEC = RunSpec(
    gripper="jaw",
    object="thing",
    population=50,
    overlaps="redraw",
    aim_for="hold",
    evaluations=600,
    generations_in_flight=2,
)
Record = Callable[..., RunFolder]


def pipeline(search: ValueSearch, spec: RunSpec) -> Pipeline:
    return Pipeline(search, shape(SPACE), spec)


def journal(spec: RunSpec) -> tuple[ValueSearch, Rows]:
    """A search that ran to its end, and its rows."""
    search = ValueSearch(spec, SPACE)
    running, pieces = pipeline(search, spec), []
    while (asked := running.ask()) is not None:
        rows = evaluate(SPACE, asked.number, asked.genomes)
        rows["index"] = asked.indices
        pieces.append(running.settle(rows).rows)
    return search, np.concatenate(pieces)


@pytest.fixture(scope="module")
def ran() -> dict[int, tuple[ValueSearch, Rows]]:
    """Searches of two seeds with their rows."""
    return {seed: journal(msgspec.structs.replace(SPEC, seed=seed)) for seed in (0, 1)}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ran) -> Record:
    """Records runs of the jaw, whose searches know the space of the make-believe object."""
    monkeypatch.setattr(source_runs, "search_space", lambda *_: SPACE)
    monkeypatch.setattr(run_plan, "row_shape", lambda *_: shape(SPACE))
    own = SimpleNamespace(on_carrier=lambda _: jaw("jaw"))
    monkeypatch.setattr(source_runs, "find_gripper", lambda _: own)

    def made(name: str, rows: int = 10**6, gripper: str = "jaw", seed: int = 0, **changed: Any) -> RunFolder:
        spec = msgspec.structs.replace(SPEC, seed=seed, **changed)
        return record_spec(
            tmp_path / name, spec, ran[seed][1][:rows], pack_scene(made_scene(gripper)), block=100
        )

    return made


def test_weights_are_those_of_one_fit_to_what_the_searches_saw(folder: Record, ran) -> None:
    learned = WarmStart.learned(SPEC, [folder("one"), folder("other", seed=1)])
    for name, weights in msgspec.structs.asdict(learned.weights).items():
        expected = pooled_weights([ran[seed][0].models[name] for seed in (0, 1)], STARTS[name])
        assert expected is not None
        assert weights == tuple(np.clip(expected, -STEEPEST_VALUE, STEEPEST_VALUE).tolist())
    check_spec(msgspec.structs.replace(SPEC, first_weights=learned.weights))
    assert [Path(run.run).name for run in learned.runs] == ["one", "other"]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"gripper": "paw"}, "is a run of the hand 'paw'"),
        ({"aim_for": "touch"}, "has aim_for 'touch' and this run 'hold'"),
        ({"method": "contact_me_scs", "aim_for": None}, "it is a run of method 'contact_me_scs'; name"),
        ({"diversity": "orientation"}, "aim_for 'hold' with diversity 'orientation'; name runs of 'aimed'"),
        ({"aim_for": "margin"}, "has aim_for 'margin' and this run 'hold'"),
        ({"protocol": "physical"}, "has protocol 'physical' and this run 'paper'"),
        ({"overlaps": "count"}, "has overlaps 'count' and this run 'redraw'"),
        ({"rows": 20}, "found too few successes or failures"),
        ({"population": 49}, "cannot be learned from"),
    ],
)
def test_a_run_that_learned_something_else_is_refused(folder: Record, changed, words: str) -> None:
    with pytest.raises(InputError, match=words):
        WarmStart.learned(SPEC, [folder("source", **changed)])


def test_a_search_without_value_takes_nothing(folder: Record) -> None:
    changed = msgspec.structs.replace(SPEC, method="me_scs", aim_for=None)
    with pytest.raises(InputError, match="leave --warm-start out"):
        WarmStart.learned(changed, [folder("source")])


def test_the_command_begins_a_run_with_weights_and_notes_their_origin(folder, tmp_path, monkeypatch) -> None:
    source, begun = folder("source"), []
    monkeypatch.setattr(
        "qdgrasp_tools.cli.run_commands.run_plan.prepare_scene",
        lambda *_, **__: PreparedScene(made_scene("jaw"), pack_scene(made_scene("jaw"))),
    )
    monkeypatch.setattr("qdgrasp_tools.cli.run_commands.run_job", lambda folder, *_: begun.append(folder))
    monkeypatch.setattr("qdgrasp_tools.cli.run_commands.print_result", lambda *_, **__: None)
    words = ["run", "--gripper", "jaw", "--object", "thing", "--protocol", "paper", "--out"]
    run = CliRunner().invoke(app, [*words, str(tmp_path / "new"), "--warm-start", str(source.path)])
    assert run.exit_code == 0, run.output
    assert len(begun) == 1
    new = RunFolder.open(tmp_path / "new")
    assert new.spec.first_weights == WarmStart.learned(SPEC, [source]).weights
    noted = msgspec.json.decode((new.path / ORIGIN).read_bytes())
    assert [run["run"] for run in noted["runs"]] == [str(source.path)]
    refused = CliRunner().invoke(app, [*words, str(tmp_path / "none"), "--warm-start", str(tmp_path / "no")])
    assert isinstance(refused.exception, FolderError)
    assert not (tmp_path / "none").exists()
