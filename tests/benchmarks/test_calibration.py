"""The calibration study: which grasps it takes, how it disturbs them, and its table, page and figure."""

import hashlib
import io
from contextlib import closing
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benchmarks.physics.calibration import __main__ as command
from benchmarks.physics.calibration import report, study, survival, table
from benchmarks.physics.calibration.study import (
    DISTURBANCES,
    IN_BULLET,
    UNSEEN,
    Design,
    Disturbance,
    Study,
    arm_error,
    choose,
    held_shares,
    weakened,
)
from benchmarks.physics.calibration.table import GraspRow, Origin, RunKey
from PIL import Image

from qdgrasp_assets.catalog import build_scene
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import GIVEN, Outcome
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.decoder import Decoder, HandPose
from qdgrasp_worker.engines import make_world
from qdgrasp_worker.evaluation_protocols import PHYSICAL
from qdgrasp_worker.object_geometry import ObjectSurface

COMMITTED = command.TABLE
DESIGN = Design(evaluations=50, best=2, held=2, successes=3, trials=2, arm=2)
BALL = RunKey("panda", "tennis_ball", 3)
ORIGIN = Origin(DESIGN.words, "c0de" * 4, "50de" * 4)
POSE = HandPose([0.0, 0.0, 0.15], [1.0, 0.0, 0.0, 0.0], [0.04, 0.04], -1)


def row(**values: Any) -> GraspRow:
    """A grasp that holds in both engines and under every disturbance."""
    said: dict[str, Any] = {
        "gripper": "panda", "object": "ycb_mug", "seed": 0, "group": "held", "place": 1, **ORIGIN._asdict(),
        "scene": "bb", "generation": 1, "index": 2, "fitness": 6, "eta": 0.9, "trials": 30, "margin": 0.01,
        "penetration_mm": 0.3, "motion_mm": 4.0, "bullet": 1.0, **{each.name: 1.0 for each in DISTURBANCES},
    }  # fmt: skip
    return GraspRow(**said | values)


class TestChoice:
    outcomes = np.array([Outcome.HELD] * 30 + [Outcome.DROPPED] * 10)
    ranked = np.array([7, 3, 31, 5])

    def test_the_best_are_those_of_the_ranking_in_its_order(self) -> None:
        assert choose(self.outcomes, self.ranked, Design(1, best=3), 0)["best"] == [7, 3, 31]

    def test_no_grasp_is_taken_twice_and_held_ones_hold(self) -> None:
        groups = choose(self.outcomes, self.ranked, Design(1, best=3, held=10, successes=20), 0)
        assert [len(places) for places in groups.values()] == [3, 10, 20]
        every = [place for places in groups.values() for place in places]
        assert len(set(every)) == len(every)
        assert all(self.outcomes[place] == Outcome.HELD for place in groups["held"])

    def test_a_draw_follows_from_the_seed(self) -> None:
        one, again, other = (choose(self.outcomes, self.ranked, Design(1), seed) for seed in (0, 0, 1))
        assert one == again
        assert one["held"] != other["held"]

    def test_of_a_few_successes_there_are_fewer(self) -> None:
        groups = choose(self.outcomes[28:32], np.array([0]), Design(1), 0)
        assert {name: len(places) for name, places in groups.items()} == {"best": 1, "held": 1, "success": 2}


class TestDisturbances:
    def test_each_has_a_column_and_some_are_of_the_rankings_kind(self) -> None:
        assert {each.name for each in (IN_BULLET, *DISTURBANCES)} <= set(table.COLUMNS)
        assert 0 < len(UNSEEN) < len(DISTURBANCES)

    def test_an_error_of_the_arm_follows_from_grasp_and_number_and_is_small(self) -> None:
        trials = [arm_error(POSE, number) for number in range(1, 201)]
        assert arm_error(POSE, 7) == trials[6]
        offsets = np.array([trial.pose.position for trial in trials]) - POSE.position
        assert offsets.std(axis=0) == pytest.approx(3e-3, rel=0.2)
        angles = 2 * np.arccos(np.abs([trial.pose.quaternion[0] for trial in trials]))
        assert np.sqrt((angles**2).mean()) == pytest.approx(np.radians(3) * np.sqrt(3), rel=0.2)
        assert all(trial.approaches and trial.pose.joints == POSE.joints for trial in trials)

    def test_weaker_drives_have_a_share_of_the_force_that_the_scene_gives_them(self) -> None:
        scene = build_scene(
            RunSpec(gripper="robotiq_2f", object="tennis_ball", protocol="physical", engine="mujoco")
        )
        limits = []
        for each in (scene, weakened(scene, 0.7)):
            with closing(make_world(each, PHYSICAL)) as world:
                limits.append([drive.limit for drive in world.drives])  # type: ignore[union-attr]
        assert limits[1] == pytest.approx([0.7 * limit for limit in limits[0]])


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> tuple[Study, list[GraspRow]]:
    """A study of a few grasps, and its rows."""
    found = Study(BALL, DESIGN, tmp_path_factory.mktemp("calibration"))
    return found, found.measure(ORIGIN)


class TestStudy:
    def test_each_group_is_there_by_place_with_scene_and_origin(self, ball) -> None:
        _, rows = ball
        assert [(each.group, each.place) for each in rows] == [
            *(("best", 1), ("best", 2)), *(("held", 1), ("held", 2)), *(("success", n) for n in (1, 2, 3)),
        ]  # fmt: skip
        assert {(each.run, each.origin) for each in rows} == {(BALL, ORIGIN)}

    def test_the_best_have_the_greatest_eta_of_all_trials(self, ball) -> None:
        found, rows = ball
        assert [each.trials for each in rows[:2]] == [100, 100]
        assert rows[0].eta == pytest.approx(found.ranking["eta"].max(), abs=1e-4)
        assert rows[0].eta >= rows[1].eta
        assert {each.trials for each in rows[2:]} == {DESIGN.trials}

    def test_a_world_without_a_disturbance_gives_the_verdicts_of_the_run(self, ball) -> None:
        found, _ = ball
        successes = found.successes[:12]
        decoded = Decoder(found.scene, GIVEN, ObjectSurface(found.scene))(found.genomes(list(range(12))))
        shares = held_shares(found.spec, Disturbance("none", "", ""), [decoded[i] for i in range(12)], 1)
        assert shares.tolist() == (successes["outcome"] == Outcome.HELD).tolist()
        assert shares.sum() > 0

    def test_without_friction_no_two_fingers_hold_a_ball(self, ball) -> None:
        found, _ = ball
        decoded = Decoder(found.scene, GIVEN, ObjectSurface(found.scene))(found.genomes([0, 1, 2]))
        slippery = Disturbance("slippery", "", "", physics={"spinning": 1e-3}, grip=1e-3)
        assert not held_shares(found.spec, slippery, [decoded[i] for i in range(3)], 1).any()

    def test_what_was_simulated_is_not_simulated_again(self, ball, monkeypatch) -> None:
        first, rows = ball
        for name in ("single_run", "evaluated", "held_shares"):
            monkeypatch.setattr(study, name, None)
        assert Study(BALL, DESIGN, first._folder).measure(ORIGIN) == rows

    def test_what_an_interrupted_study_lacks_alone_is_simulated(self, ball, monkeypatch) -> None:
        first, rows = ball
        (lost,) = first._folder.glob("*-arm.npz")
        lost.unlink()
        made: list[str] = []

        def watched(spec: RunSpec, disturbance: Disturbance, *others: Any) -> Any:
            made.append(disturbance.name)
            return held_shares(spec, disturbance, *others)

        monkeypatch.setattr(study, "held_shares", watched)
        assert Study(BALL, DESIGN, first._folder).measure(ORIGIN) == rows
        assert made == ["arm"]

    def test_a_run_without_a_grasp_is_told_in_a_sentence(self, ball, monkeypatch, tmp_path) -> None:
        rows = ball[0].successes.copy()
        rows["outcome"] = Outcome.DROPPED
        monkeypatch.setattr(study, "single_run", lambda spec: SimpleNamespace(rows=rows))
        with pytest.raises(InputError, match="no grasp in 50 evaluations; take more"):
            Study(BALL, DESIGN, tmp_path).measure(ORIGIN)


class TestTable:
    rows = (row(place=2), row(), row(seed=1), row(group="best"), row(gripper="allegro", margin=0.123456))

    def test_a_table_comes_back_as_it_was_in_its_order(self, tmp_path) -> None:
        file = tmp_path / "c.csv"
        assert table.read(file) == []
        file.write_text(table.text(self.rows))
        found = table.read(file)
        assert [(each.gripper, each.seed, each.group, each.place) for each in found] == [
            ("allegro", 0, "held", 1),
            ("panda", 0, "best", 1),
            ("panda", 0, "held", 1),
            ("panda", 0, "held", 2),
            ("panda", 1, "held", 1),
        ]
        assert found[0].margin == 0.12346
        assert table.text(found) == table.text(self.rows)

    def test_a_run_takes_the_place_of_what_was_in_of_it(self, tmp_path) -> None:
        file, again = tmp_path / "c.csv", row(eta=0.5, code="new")
        file.write_text(table.text(self.rows))
        found = table.add(file, again.run, [again])
        assert [each for each in found if each.run == again.run] == [again]
        assert len(found) == 3

    def test_a_run_of_other_numbers_or_code_is_not_in(self) -> None:
        run = RunKey("panda", "ycb_mug", 0)
        assert table.is_measured(self.rows, run, ORIGIN)
        assert not table.is_measured(self.rows, run, ORIGIN._replace(code="other"))
        assert not table.is_measured([*self.rows, row(code="other")], run, ORIGIN)
        assert not table.is_measured(self.rows, run._replace(seed=5), ORIGIN)

    @pytest.mark.parametrize(
        ("old", "new", "said"),
        [
            ("gripper,", "hand,", "line 1: its columns"),
            (",held,", ",worst,", "line 3"),
            (",0.9,", ",much,", "line 2"),
        ],
    )
    def test_another_table_is_refused_with_its_line(self, tmp_path, old, new, said) -> None:
        file = tmp_path / "c.csv"
        file.write_text(table.text([row(group="best"), row()]).replace(old, new, 1))
        with pytest.raises(InputError, match=said):
            table.read(file)


def told(predictor: list[float], survived: list[float]) -> survival.Interval:
    return survival.concordance([(np.array(predictor), np.array(survived))])


class TestConcordance:
    @pytest.mark.parametrize(
        ("predictor", "survived", "share"),
        [
            ([1, 2, 3, 4], [0, 0, 1, 1], 1.0),
            ([4, 3, 2, 1], [0, 0, 1, 1], 0.0),
            ([1, 1, 1, 1], [0, 0, 1, 1], 0.5),
            ([1, 3, 2, 4], [0, 0, 1, 1], 0.75),
            ([1, 2, 2], [0.0, 0.5, 1.0], 2.5 / 3),
        ],
    )
    def test_it_is_the_share_of_pairs_in_order(self, predictor, survived, share) -> None:
        assert told(predictor, survived).value == pytest.approx(share)

    def test_grasps_of_two_scenes_are_not_compared(self) -> None:
        scenes = [(np.array([1.0, 2.0]), np.array([0.0, 0.1])), (np.array([0.3, 0.2]), np.array([1.0, 0.9]))]
        assert survival.concordance(scenes).value == 1.0

    def test_where_all_survive_alike_there_is_none(self) -> None:
        assert told([1, 2, 3], [1, 1, 1]).words == ""

    def test_chance_is_within_the_interval_of_noise_and_not_of_a_good_predictor(self) -> None:
        random = np.random.default_rng(0)
        survived = random.random(80)
        noise, good = told(random.random(80), survived), told(survived + random.normal(0, 0.3, 80), survived)
        assert noise.low < 0.5 < noise.high
        assert 0.5 < good.low < good.value < good.high < 1


class TestSurvival:
    def test_it_is_the_share_of_unseen_disturbances(self) -> None:
        some = [row(), row(weight_500=0.0), row(arm=0.0, friction_070=0.0)]
        assert survival.survival(some).tolist() == pytest.approx([1, 1 - 1 / len(UNSEEN), 1])
        assert len(survival.survival([])) == 0

    def test_bins_have_each_grasp_once(self) -> None:
        some = [row(eta=eta, margin=eta, index=i) for i, eta in enumerate((0.0, 0.5, 0.79, 0.8, 0.95, 1.0))]
        assert [(each.name, len(each.rows)) for each in survival.eta_bins(some)] == [
            ("0 to 0.5", 1), ("0.5 to 0.8", 2), ("0.8 to 0.95", 1), ("0.95 to 1", 2),
        ]  # fmt: skip
        assert [[each.margin for each in third.rows] for third in survival.margin_bins(some)] == [
            [0.0, 0.5], [0.79, 0.8], [0.95, 1.0],
        ]  # fmt: skip

    def test_engines_that_disagree_are_told_apart(self) -> None:
        some = [row(), row(bullet=0.0), row(fitness=5), row(fitness=5, bullet=0.0)]
        assert [each.name for each in survival.engine_bins(some)] == [
            "both", "MuJoCo alone", "Bullet alone", "neither",
        ]  # fmt: skip

    def test_a_difference_of_groups_is_a_mean_over_scenes(self) -> None:
        pairs = [(np.array([1.0, 1.0]), np.array([0.0])), (np.array([0.5]), np.array([0.5, 0.5]))]
        assert survival.difference_interval(pairs) == (0.5, 0.5, 0.5)
        assert survival.difference_interval([(np.array([]), np.array([1.0]))]).words == ""


class TestPage:
    def test_it_says_that_no_robot_was_used_and_what_is_in(self) -> None:
        text = report.page([])
        assert "**No robot was used.**" in text
        assert "0 of the 24 runs of the study are in." in text

    def test_it_has_the_best_beside_random_ones_and_the_papers_figure(self) -> None:
        best = [row(group="best", place=n, eta=0.95, index=n) for n in (1, 2)]
        held = [row(place=n, weight_500=0.0, bullet=0.0, index=9 + n) for n in (1, 2)]
        lines = report.page([*best, *held]).splitlines()
        every = next(line for line in lines if line.startswith("| panda | **all 1** |"))
        less = 1 / len(UNSEEN)
        whole, of_held, difference = (f"{x:.2f} ({x:.2f} to {x:.2f})" for x in (1.0, 1 - less, less))
        assert [cell.strip() for cell in every.strip("|").split("|")] == [
            "panda", "**all 1**", "2", "0.95", "1.00", "1.00", whole, whole, "2", of_held, difference, "0.95",
        ]  # fmt: skip
        (found,) = [line for line in lines if line.startswith("- **panda**")]
        assert found.startswith(
            "- **panda**, 1 object: the 2 best-ranked grasps survive 1.00 (1.00 to 1.00) of"
        )
        assert "| weight x 5 | yes | 1.00 (1.00 to 1.00) | 0.00 (0.00 to 0.00) |" in lines

    def test_a_hand_without_a_figure_in_the_paper_has_none(self) -> None:
        lines = report.page([row(gripper="barrett", group=group) for group in ("best", "held")]).splitlines()
        assert next(line for line in lines if "**all 1**" in line).endswith("|  |")

    def test_the_figure_says_which_table_it_was_drawn_from(self) -> None:
        rows = [row(index=i, eta=eta, friction_050=float(eta > 0.5)) for i, eta in enumerate((0.2, 0.6, 1.0))]
        image = Image.open(io.BytesIO(report.png(rows)))
        assert image.text[report.TABLE_DIGEST] == hashlib.sha256(table.text(rows).encode()).hexdigest()


def test_page_and_figure_that_lie_beside_the_table_are_those_that_it_makes() -> None:
    rows = table.read(COMMITTED)
    assert COMMITTED.read_text() == table.text(rows)
    assert COMMITTED.with_suffix(".md").read_text() == report.page(rows)
    lies, made = (Image.open(each) for each in (COMMITTED.with_suffix(".png"), io.BytesIO(report.png(rows))))
    assert lies.text == made.text | {"Software": lies.text["Software"]}
    apart = [np.asarray(each.convert("L"), dtype=np.float64) for each in (lies, made)]
    assert np.abs(apart[0] - apart[1]).mean() < 2  # Of 255: letters may differ with the version of matplotlib


class TestCommand:
    @pytest.mark.parametrize(
        ("words", "said"),
        [
            ([], "--out is missing"),
            (["--out", "x", "--scenes", "panda"], "must be HAND:OBJECT"),
            (["--out", "x", "--best", "0"], "must be a whole number greater than 0"),
            (["--out", "x", "--scenes", "panda:nothing"], "nothing"),
            (["--page", "--table", "none.csv"], "there is no table none.csv"),
        ],
    )
    def test_bad_words_are_refused_in_a_sentence(self, words, said, capsys, tmp_path, monkeypatch) -> None:
        monkeypatch.chdir(tmp_path)
        with pytest.raises(SystemExit) as end:
            command.main([*words, *([] if "--table" in words else ["--table", "t.csv"])])
        assert end.value.code == 2
        assert said in capsys.readouterr().err

    def test_a_run_that_is_in_is_not_measured_again(self, tmp_path, monkeypatch, capsys) -> None:
        file, design = tmp_path / "c.csv", Design(60)
        origin = command.origin_of(design)
        file.write_text(table.text([row(**origin._asdict())]))
        monkeypatch.setattr(command, "Study", None)
        words = f"--out {tmp_path} --table {file} --scenes panda:ycb_mug --seeds 0 --evaluations 60"
        command.main(words.split())
        assert "is in" in capsys.readouterr().err
