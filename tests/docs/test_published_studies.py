"""Tables of the two studies beside the page of results, recomputed from their CSVs by other means."""

import re
from itertools import product

import numpy as np
import pandas
import pytest
from tests.docs.test_published_numbers import (
    DRAWS,
    RESULTS,
    TUNING,
    Runs,
    Values,
    bootstrap,
    lines_with,
    near,
)

HANDS = ("panda", "allegro")
UNSEEN = (
    "friction_050", "weight_200", "weight_500", "torsion_017", "effort_070", "together", "paper_bullet"
)  # fmt: skip
OF_THE_KIND = ("friction_070", "arm")
BINS = {"eta": 4, "margin": 3, "engines": 4}
"""How many ranges a figure is divided into."""
PAGE, LEFT_OUT = (
    (RESULTS / name).read_text(encoding="utf-8") for name in ("calibration.md", "leave-one-out.md")
)
FOUND = r"(\d\.\d\d) \((-?\d\.\d\d) to (-?\d\.\d\d)\)"
"""A number with its interval."""
FINDING = (
    rf"- \*\*{{hand}}\*\*, \d objects?: the (\d+) best-ranked grasps survive {FOUND} of the unseen "
    rf"disturbances, (\d+) random ones that hold {FOUND}; the difference is {FOUND}\. Of pairs of random "
    rf"ones that hold, the one that survives more is told by eta in {FOUND}, by margin in {FOUND}, by both "
    rf"engines in {FOUND}\."
)
"""A sentence of the page."""


@pytest.fixture(scope="module")
def ranked() -> Runs:
    """The grasps of the calibration study."""
    table = pandas.read_csv(RESULTS / "calibration.csv")
    table["survival"] = table[[*UNSEEN]].mean(axis=1)
    table["of_the_kind"] = table[[*OF_THE_KIND]].mean(axis=1)
    table["mujoco"] = table["fitness"] == 6
    table["both"] = table["mujoco"] & (table["bullet"] == 1)
    return table


def of_scenes(grasps: Runs, told: str = "survival") -> list[Values]:
    """The survival of the grasps of each scene, or another column."""
    return [scene[told].to_numpy(float) for _, scene in grasps.groupby("object")]


def ends_of(*groups: list[Values]) -> Values:
    """The 95 % interval of the mean over scenes, of a group or of the first less the second."""
    random, means = np.random.default_rng(2), []
    for group in groups:
        drawn = [random.choice(scene, (DRAWS, len(scene))).mean(axis=1) for scene in group]
        means.append(np.mean(drawn, axis=0))
    return np.quantile(means[0] if len(means) == 1 else means[0] - means[1], (0.025, 0.975))


def mean_of(group: list[Values]) -> float:
    return np.mean([scene.mean() for scene in group])


def check(said: str, value: float, ends: Values) -> None:
    """Check a number and its interval."""
    shown = [float(number) for number in re.fullmatch(FOUND, said).groups()]
    assert shown[0] == pytest.approx(value, abs=0.00501)
    assert all(near(a, b, ends[1] - ends[0] + 0.07) for a, b in zip(shown[1:], ends, strict=True))


def random_held(grasps: Runs) -> Runs:
    """The grasps that were drawn at random and hold in MuJoCo."""
    return grasps[(grasps["group"] != "best") & grasps["mujoco"]]


def concordance(grasps: Runs, figure: str, told: str = "survival") -> float:
    """How often the grasp with the greater figure has the greater `told`, of two of a scene that differ."""
    right = pairs = 0.0
    for _, scene in grasps.groupby("object"):
        values, survived = scene[figure].to_numpy(float), scene[told].to_numpy()
        more = survived[:, None] > survived
        right += np.sum(more * (np.sign(values[:, None] - values) + 1) / 2)
        pairs += np.sum(more)
    return right / pairs


def test_the_survival_of_ranked_grasps_is_that_of_the_table(ranked: Runs) -> None:
    page = " ".join(PAGE.split())
    for hand, grasps in ranked.groupby("gripper"):
        best, held = (of_scenes(grasps[grasps["group"] == group]) for group in ("best", "held"))
        said = re.search(FINDING.format(hand=hand), page)
        assert said
        count, *numbers = said.groups()
        assert (int(count), int(numbers.pop(3))) == (sum(map(len, best)), sum(map(len, held)))
        told = [concordance(random_held(grasps), name) for name in ("eta", "margin", "both")]
        means = [mean_of(best), mean_of(held)]
        assert numbers[::3] == [f"{value:.2f}" for value in (*means, means[0] - means[1], *told)]
        for place, groups in enumerate(([best], [held], [best, held])):
            low, high = map(float, numbers[3 * place + 1 : 3 * place + 3])
            ends = zip((low, high), ends_of(*groups), strict=True)
            assert all(near(shown, end, high - low + 0.02) for shown, end in ends)


def test_the_advice_on_trust_has_the_numbers_of_the_table(ranked: Runs) -> None:
    page = " ".join((RESULTS.parent / "trust.md").read_text(encoding="utf-8").split())
    said = re.search(
        r"best-ranked grasps of a run survive (\S+) and (\S+) of them with the Panda and the Allegro hand, "
        r"random grasps that hold (\S+) and (\S+)\. .* by eta in (\S+) and (\S+) of pairs, by the margin "
        r"in (\S+) and (\S+), and by holding in the second engine too in (\S+) and (\S+) \(.* Nine in ten "
        r"grasps .* does not survives (\S+) and (\S+), where the others survive (\S+) and (\S+):",
        page,
    )
    values = []
    for hand in HANDS:
        grasps = ranked[ranked["gripper"] == hand]
        groups = (of_scenes(grasps[grasps["group"] == group]) for group in ("best", "held"))
        held = random_held(grasps)
        assert held["both"].mean() == pytest.approx(0.9, abs=0.05)
        values.append(
            [
                *map(mean_of, groups),
                *(concordance(held, name) for name in ("eta", "margin", "both")),
                *(held[held["both"] == is_in_both]["survival"].mean() for is_in_both in (False, True)),
            ]
        )
    assert said.groups() == tuple(f"{value:.2f}" for pair in zip(*values, strict=True) for value in pair)


def test_the_page_on_coverage_says_how_often_margin_and_penetration_tell_eta(ranked: Runs) -> None:
    is_tuning = (ranked["gripper"] == "panda") & ranked["object"].isin(["ycb_mug", "ycb_power_drill"])
    held = random_held(ranked[is_tuning])
    held = held.assign(little=-held["penetration_mm"])
    told = [concordance(held, name, "eta") for name in ("margin", "little")]
    page = " ".join((RESULTS.parent / "coverage.md").read_text(encoding="utf-8").split())
    said = re.search(r"had the greater epsilon in (\S+) of pairs, and less penetration in (\S+) \(", page)
    assert said.groups() == tuple(f"{value:.2f}" for value in told)


def test_the_best_ranked_grasps_are_those_of_the_table(ranked: Runs) -> None:
    lines = re.findall(
        r"^\| (panda|allegro) \| (ycb_\w+|\*\*all 4\*\*) \| (\d+ \| \d\.\d\d \| .*) \|$", PAGE, re.MULTILINE
    )
    assert len(lines) == 10
    for hand, target, cells in lines:
        is_meant = target.startswith("**") | (ranked["object"] == target)
        grasps = ranked[(ranked["gripper"] == hand) & is_meant]
        best, held = (grasps[grasps["group"] == group] for group in ("best", "held"))
        count, eta, mujoco, both, *said, less, _ = cells.split(" | ")
        assert (int(count), int(said.pop(2))) == (len(best), len(held))
        for shown, column in ((eta, "eta"), (mujoco, "mujoco"), (both, "both")):
            assert float(shown) == pytest.approx(mean_of(of_scenes(best, column)), abs=0.00501)
        for shown, of in zip(said, (best, best[best["both"]], held), strict=True):
            check(shown, mean_of(of_scenes(of)), ends_of(of_scenes(of)))
        pair = of_scenes(best), of_scenes(held)
        check(less, mean_of(pair[0]) - mean_of(pair[1]), ends_of(*pair))


def test_survival_by_disturbance_is_that_of_the_table(ranked: Runs) -> None:
    lines = lines_with(PAGE, "disturbance")
    for column, line in zip((*UNSEEN, *OF_THE_KIND), lines, strict=True):
        assert line["unseen"] == ("yes" if column in UNSEEN else "no")
        for hand, (group, words) in product(HANDS, (("best", "best-ranked"), ("held", "random held"))):
            grasps = ranked[(ranked["gripper"] == hand) & (ranked["group"] == group)]
            scenes = of_scenes(grasps, column)
            check(line[f"{hand}, {words}"], mean_of(scenes), ends_of(scenes))


def test_how_well_survival_is_told_is_that_of_the_table(ranked: Runs) -> None:
    drawn = ranked[ranked["group"] != "best"].assign(
        little=-ranked["penetration_mm"], still=-ranked["motion_mm"], then=ranked["both"] + ranked["eta"] / 2
    )
    columns = ("eta", "margin", "both", "then", "fitness", "little", "still")
    for column, line in zip(columns, lines_with(PAGE, "figure")[: len(columns)], strict=True):
        for head, said in list(line.items())[1:]:
            hand, words, count = re.fullmatch(r"(\w+), (.*) \((\d+)\)", head).groups()
            grasps = drawn[(drawn["gripper"] == hand) & (("hold" not in words) | drawn["mujoco"])]
            told = "of_the_kind" if "kind" in words else "survival"
            assert int(count) == len(grasps)
            random = np.random.default_rng(3)
            again = [concordance(resampled(random, grasps), column, told) for _ in range(100)]
            check(said, concordance(grasps, column, told), np.quantile(again, (0.025, 0.975)))


def resampled(random: np.random.Generator, grasps: Runs) -> Runs:
    """As many grasps of each scene, drawn with replacement."""
    places = [random.choice(here, len(here)) for here in grasps.groupby("object").indices.values()]
    return grasps.iloc[np.concatenate(places)]


def test_survival_by_eta_margin_and_engines_is_that_of_the_table(ranked: Runs) -> None:
    drawn = ranked[ranked["group"] != "best"].copy()
    drawn["eta_bin"] = pandas.cut(drawn["eta"], [0, 0.5, 0.8, 0.95, 2], right=False).cat.codes
    ranks = drawn.groupby(["gripper", "object"])["margin"].rank(method="first", pct=True)
    drawn["margin_bin"] = np.ceil(3 * ranks - 1e-9).astype(int) - 1
    drawn["engines_bin"] = 3 - 2 * drawn["mujoco"] - (drawn["bullet"] == 1)
    bins = [(hand, name, each) for hand in HANDS for name in BINS for each in range(BINS[name])]
    for (hand, name, each), line in zip(bins, lines_with(PAGE, "range"), strict=True):
        grasps = drawn[(drawn["gripper"] == hand) & (drawn[f"{name}_bin"] == each)]
        assert (line["hand"], int(line["grasps"])) == (hand, len(grasps))
        assert float(line["mean eta"]) == pytest.approx(grasps["eta"].mean(), abs=0.00501)
        for head, told in (("survival", "survival"), ("of the ranking's kind", "of_the_kind")):
            values = grasps[told].to_numpy()
            check(line[head], values.mean(), ends_of([values]))


@pytest.fixture(scope="module")
def varied() -> Runs:
    """Cells that hold of each run with refitted or varied constants, by variant and seed, for each object."""
    table = pandas.read_csv(RESULTS / "leave-one-out.csv")
    return table.pivot_table(index=["variant", "seed"], columns="scene", values="robust_cells")


def mean_and_spread(cells: pandas.Series) -> str:
    return f"{cells.mean():.0f} ± {cells.std():.0f}"


def scores(varied: Runs) -> Runs:
    """The scores of the runs on the tuning objects, which are those of today's and of varied constants."""
    tuned = varied[TUNING].dropna()
    return tuned / tuned.groupby("variant").mean().mean()


def test_each_varied_constant_has_the_score_of_its_runs(varied: Runs) -> None:
    tuned, lines = scores(varied).groupby("variant").mean(), lines_with(LEFT_OUT, "mean score")
    assert {line["variant"].strip("`") for line in lines} == set(tuned.index)
    for line in lines:
        name = line["variant"].strip("`")
        for scene in TUNING:
            cells = varied[scene][name].dropna()
            assert line[scene] == f"{mean_and_spread(cells)} ({tuned[scene][name]:.3f})"
        assert float(line["mean score"]) == pytest.approx(tuned.loc[name].mean(), abs=0.000501)


def test_refitted_constants_are_the_best_on_the_objects_in_use(varied: Runs) -> None:
    today, *lines = lines_with(LEFT_OUT, "beyond it")
    for line in lines:
        used = [scene for scene in TUNING if scene != line["chosen on"].removeprefix("all but ")]
        tuned = scores(varied)[used]
        means = tuned.groupby("variant").mean().mean(axis=1)
        squares = 2 * (tuned.groupby("variant").var() / 3).mean()
        assert line["standard error"] == f"{np.sqrt(squares.sum()) / len(used):.4f}"
        for head, said in line.items():
            if head.startswith("`"):
                others = means[means.index.str.startswith(head.strip("`") + "=")]
                is_better = others.max() > means["today"]
                expected = f"**{others.idxmax().partition('=')[2]}**" if is_better else today[head]
                assert said == expected


def test_refitted_constants_on_other_objects_are_compared_by_their_runs(varied: Runs) -> None:
    others = [scene for scene in varied.columns if scene not in TUNING]
    on_others = varied[others].dropna()
    shares = on_others / on_others.loc["today"].mean()
    of_today = [shares[scene]["today"].to_numpy() for scene in others]
    for line in lines_with(LEFT_OUT, "today's interval"):
        refitted = [shares[scene][line["constants"].strip("`")].to_numpy() for scene in others]
        nothing = [np.zeros(2)] * len(others)
        for head, arms, less in (
            ("95 % interval", (refitted, of_today), 0), ("today's interval", (of_today, nothing), 1)
        ):  # fmt: skip
            low, high, _ = bootstrap(list(zip(*arms, strict=True)), is_ratio=False)
            shown = [float(end) / 100 + less for end in line[head].split(" to ")]
            assert all(near(a, b, high - low) for a, b in zip(shown, (low, high), strict=True))
        assert line["equivalent"] == "**not shown**"
    lines = lines_with(LEFT_OUT, "object")
    assert [line.pop("object") for line in lines] == others
    for scene, line in zip(others, lines, strict=True):
        for head, said in line.items():
            assert said == mean_and_spread(on_others[scene][head.strip("`")])


def test_refitted_constants_differ_from_todays_as_the_page_and_the_results_say() -> None:
    table = pandas.read_csv(RESULTS / "leave-one-out.csv")
    means = table.pivot_table(index="scene", columns="variant", values="robust_cells")
    on_others = means.drop(["ycb_rubiks_cube", "ycb_mug", "ycb_power_drill"])
    lines = {line["chosen on"]: line for line in lines_with(LEFT_OUT, "difference, %")}
    for line in lines.values():
        ratio = on_others[line["constants"].strip("`")] / on_others["today"]
        assert float(line["difference, %"]) == pytest.approx(100 * (ratio.mean() - 1), abs=0.051)
        low, high = map(float, line["today's interval"].split(" to "))
        assert ("not" in line["verdict"]) != (low < float(line["difference, %"]) < high)
    assert {name for name, line in lines.items() if "not" in line["verdict"]} == {"all but ycb_power_drill"}
    assert {line["beyond it"] for line in lines_with(LEFT_OUT, "beyond it")[1:]} == {"none"}
    without = on_others[lines["all but ycb_power_drill"]["constants"].strip("`")] / on_others["today"] - 1
    assert without.idxmin() == "ycb_cracker_box"
    pages = (RESULTS.parent / "results.md", RESULTS / "methods.md")
    results, methods = (" ".join(page.read_text(encoding="utf-8").split()) for page in pages)
    drill, of_all = (
        (line["difference, %"].lstrip("-"), f"{line['95 % interval']} %)")
        for line in (lines["all but ycb_power_drill"], lines["all three"])
    )
    assert f"{drill[0]} % fewer cells (interval {drill[1]}" in results
    assert f"{drill[0]} % fewer cells that hold (interval {drill[1]}" in methods
    assert f"they have {of_all[0]} % fewer ({of_all[1]}" in methods
    errors = {line["chosen on"]: line["standard error"] for line in lines_with(LEFT_OUT, "standard error")}
    *with_drill, without = (100 * float(errors[name]) for name in lines)
    assert f"error of a gain is {min(with_drill):.0f} to {max(with_drill):.0f} %" in results
    assert f"on cube and mug alone it is {without:.1f} %" in results
