"""Carrying out what is missing: stage by stage, and on from where it stopped."""

import signal
from pathlib import Path

import pytest
from tests.benchmarks.results import work
from tests.benchmarks.results.plan import Costs, stages
from tests.benchmarks.results.programme import Programme, Wanted
from tests.benchmarks.results.store import Store
from tests.results.make_rows import TODAY

from qdgrasp_coordinator.campaigns.campaign_folder import begin
from qdgrasp_coordinator.watching.supervisor import Team
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.spec import RunSpec

TEAM = Team(workers=1)


def wanted(seed: int, evaluations: int = 1000) -> Wanted:
    spec = RunSpec(gripper="panda", object="mug", method="me_rand", seed=seed, evaluations=evaluations)
    return Wanted(f"panda-mug-me_rand-s{seed}", spec)


class TestGrowing:
    def budgets(self, place: Path, *stage: Wanted) -> list[tuple[str, int]]:
        asked = work.grown(place, stage)
        begin(place, asked)
        return [(name, spec.evaluations) for name, spec in asked.runs.items()]

    def test_runs_are_called_as_the_programme_calls_them(self, tmp_path) -> None:
        assert self.budgets(tmp_path / "a", wanted(0)) == [(wanted(0).name, 1000)]

    def test_a_later_stage_keeps_what_was_begun_and_extends_it(self, tmp_path) -> None:
        place = tmp_path / "a"
        self.budgets(place, wanted(0), wanted(1))
        assert self.budgets(place, wanted(2), wanted(1, 5000)) == [
            (wanted(0).name, 1000), (wanted(1).name, 5000), (wanted(2).name, 1000),
        ]  # fmt: skip

    def test_a_run_never_gets_a_smaller_budget(self, tmp_path) -> None:
        place = tmp_path / "a"
        self.budgets(place, wanted(0, 5000))
        assert self.budgets(place, wanted(0)) == [(wanted(0).name, 5000)]


class TestCarryingOn:
    known = Programme({"some": (*(wanted(seed) for seed in range(3)), wanted(0, 2000))})

    @pytest.fixture
    def store(self, tmp_path, monkeypatch) -> Store:
        monkeypatch.setattr(work, "workplace", lambda runs: runs / "here")
        return Store(tmp_path / "runs.csv", self.known, {TODAY})

    def test_each_run_is_tried_once_and_a_failure_stops_no_other(self, store, tmp_path, monkeypatch) -> None:
        tried: list[Wanted] = []

        def fail(_place: Path, stage: list[Wanted], *_: object) -> None:
            tried.extend(stage)
            raise InputError("no such mesh")

        monkeypatch.setattr(work, "work", fail)
        failures = work.carry_on(store, self.known, tmp_path, TEAM, Stop())
        assert sorted(one.key for one in tried) == sorted(self.known.wanted)
        assert len(failures) == len(list(stages(tried, Costs([]))))

    def test_what_is_not_on_this_machine_is_told_of_and_left_out(self, store, tmp_path, monkeypatch) -> None:
        tried: list[Wanted] = []
        monkeypatch.setattr(work, "work", lambda _place, stage, *_: tried.extend(stage))
        absent = Wanted("absent", RunSpec(gripper="claw", object="mug"))
        both = Programme({"some": (wanted(0), absent)})
        failures = work.carry_on(Store(store.file, both, {TODAY}), both, tmp_path, TEAM, Stop())
        assert [str(error)[:22] for error in failures] == ["Unknown gripper 'claw'"]
        assert tried == [wanted(0)]

    def test_a_signal_ends_it_after_the_stage(self, store, tmp_path, monkeypatch) -> None:
        stop, stages_done = Stop(), []

        def stopped(*_: object) -> None:
            stages_done.append(1)
            stop.set(signal.SIGINT)

        monkeypatch.setattr(work, "work", stopped)
        assert work.carry_on(store, self.known, tmp_path, TEAM, stop) == []
        assert len(stages_done) == 1


def test_the_place_of_runs_depends_on_what_evaluates_and_on_what_searches(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(work, "platform", lambda: {"code": "a"})
    before = work.workplace(tmp_path)
    assert work.workplace(tmp_path) == before
    monkeypatch.setattr(work, "platform", lambda: {"code": "b"})
    assert work.workplace(tmp_path) != before
    monkeypatch.setattr(work, "platform", lambda: {"code": "a"})
    monkeypatch.setattr(work, "_search_digest", lambda: b"another")
    assert work.workplace(tmp_path) != before
