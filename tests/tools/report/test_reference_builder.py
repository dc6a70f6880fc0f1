import itertools
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from tests.coordinator.recorded_runs import record, record_spec
from tests.coordinator.scenes import made_scene
from typer.testing import CliRunner

from qdgrasp_assets.scene import pack_scene
from qdgrasp_coordinator.metrics.reference_coverage import (
    ReferenceLookup,
    object_identity,
    read_reference,
    read_references,
)
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import AssetError, InputError
from qdgrasp_protocol.rows import Outcome, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.cli.main import app
from qdgrasp_tools.report import reference_builder
from qdgrasp_tools.report.reference_builder import build_reference_sets, reference_set_of
from qdgrasp_tools.report.run_groups import distinct_searches, read_histories

SHAPE = RowShape(genes=2, joints=2)
Found = dict[tuple[int, int, int], Outcome]
Runs = Callable[..., RunFolder]


def rows_of(found: Found) -> Rows:
    rows = SHAPE.empty(len(found))
    rows["index"], rows["outcome"] = np.arange(len(found)), list(found.values())
    rows["fitness"] = np.maximum(rows["outcome"].astype(np.float32) - Outcome.DROPPED, 0)
    rows["base_to_object"][:, :3] = np.array(list(found), np.float32).reshape(-1, 3) / 100
    rows["descriptor"] = rows["base_to_object"][:, :3]
    return rows


@pytest.fixture
def run(tmp_path: Path) -> Runs:
    """Makes runs on an object of one's own, with given successes."""
    numbers = itertools.count()

    def make(
        found: Found | Rows,
        gripper: str = "jaw",
        object_: str = "block.stl",
        com: float = 0.0,
        seed: int = 0,
        evaluations: int = 10_000,
        method: str = "aimed",
        **settings: str,
    ) -> RunFolder:
        scene = made_scene(gripper)
        body = msgspec.structs.replace(scene.object, name=Path(object_).stem, com_in_mesh=(com, 0.0, 0.0))
        bundle = pack_scene(msgspec.structs.replace(scene, object=body, **settings))
        length = {"seed": seed, "evaluations": evaluations, "method": method}
        spec = RunSpec(gripper=gripper, object=object_, mass=0.1, **length, **settings)
        rows = rows_of(found) if isinstance(found, dict) else found
        return record_spec(tmp_path / f"run{next(numbers)}", spec, rows, bundle, block=1)

    return make


A, B, C = (1, 2, 3), (-4, 0, 9), (-4, 0, -9)


def groups(path: Path, name: str = "block") -> Found:
    known = read_reference(path, name)
    return {tuple(cell): fitness for cell, fitness in zip(known.cells.tolist(), known.fitness, strict=True)}


def test_a_set_holds_the_successes_and_nothing_else(run: Runs, tmp_path: Path) -> None:
    out = tmp_path / "set.npz"
    build_reference_sets([run({A: Outcome.DROPPED, B: Outcome.HELD, C: Outcome.BRUSHED})], out)
    assert groups(out) == {B: 2, A: 0}
    with np.load(out) as arrays:
        assert (arrays["block.cm"].dtype, arrays["block.fitness"].dtype) == (np.int16, np.uint8)
        assert arrays["block.cm"].tolist() == sorted([list(A), list(B)])


def test_randomised_trials_are_left_out(run: Runs, tmp_path: Path) -> None:
    rows = rows_of({A: Outcome.HELD, B: Outcome.HELD})
    rows["trial"] = [1, 0]
    build_reference_sets([run(rows)], tmp_path / "set.npz")
    assert groups(tmp_path / "set.npz") == {B: 2}


def test_a_cell_keeps_the_best_fitness_of_all_runs_in_any_order(run: Runs, tmp_path: Path) -> None:
    runs = [run({A: Outcome.SHAKEN, B: Outcome.HELD}), run({A: Outcome.HELD, C: Outcome.DROPPED})]
    there, back, slowly = (tmp_path / name for name in ("there.npz", "back.npz", "slowly.npz"))
    build_reference_sets(runs, there)
    build_reference_sets(runs[::-1], back)
    for folder in (*runs, *runs):
        build_reference_sets([folder], slowly)
    assert groups(there) == {A: 2, B: 2, C: 0}
    assert there.read_bytes() == back.read_bytes() == slowly.read_bytes()


HELD, DROPPED = Outcome.HELD, Outcome.DROPPED
DAY, MONTH = 100, 3000  # Evaluations of a short record of a run, and of a longer one


def incidence(path: Path) -> dict[tuple[int, int, int], list[int]]:
    """1 + fitness of each run in each cell, sorted."""
    known = read_reference(path, "block")
    assert known.by_run is not None
    cells = map(tuple, known.cells.tolist())
    return dict(zip(cells, np.sort(known.by_run.T, axis=1).tolist(), strict=True))


def test_a_set_remembers_in_how_many_runs_each_cell_was_found_and_held(run: Runs, tmp_path: Path) -> None:
    out = tmp_path / "set.npz"
    founds = ({A: HELD, B: DROPPED}, {A: DROPPED}, {A: HELD, C: HELD}, {A: Outcome.MISSED})
    build_reference_sets([run(found, seed=seed) for seed, found in enumerate(founds)], out)
    assert incidence(out) == {A: [0, 1, 3, 3], B: [0, 0, 0, 1], C: [0, 0, 0, 3]}
    known = read_reference(out, "block")
    assert known.origin is not None
    assert len({*known.origin.runs}) == 4
    assert (known.estimate.runs, known.estimate.once, known.estimate.seen) == (4, 2, 3)
    held = known.robust.estimate
    assert (held.runs, held.once, held.twice, held.seen) == (4, 1, 1, 2)


@pytest.mark.parametrize("order", [*itertools.permutations(range(3))])
def test_a_run_counts_once_however_often_and_however_long_it_is_added(run, tmp_path, order) -> None:
    """A run is added before its end and after it; the budget is no part of its identity."""
    out, whole = tmp_path / "set.npz", tmp_path / "whole.npz"
    early = run({A: DROPPED}, evaluations=DAY)
    late = run({A: DROPPED, B: HELD, C: DROPPED}, evaluations=MONTH)
    other = run({A: HELD, B: DROPPED}, seed=1)
    for place in (*order, 0):
        build_reference_sets([(early, late, other)[place]], out)
    assert incidence(out) == {A: [1, 3], B: [1, 3], C: [0, 1]}
    build_reference_sets([other, late], whole)
    assert out.read_bytes() == whole.read_bytes()


def test_a_run_is_known_by_its_search_and_scene_not_by_where_its_files_lie(run: Runs) -> None:
    def digests(**settings: object) -> tuple[str, ...]:
        origin = reference_set_of(run({A: HELD}, **settings)).origin
        assert origin is not None
        return origin.runs

    assert digests() == digests(evaluations=7) == digests(object_="elsewhere/block.stl")
    others = [digests(), digests(seed=1), digests(com=0.01), digests(protocol="released")]
    assert len({*others}) == 4


def test_searches_of_ones_own_are_told_apart_by_their_finds(run: Runs) -> None:
    one, other, copy = (
        run({cell: Outcome.HELD}, evaluations=1, method="custom_contact") for cell in (A, B, A)
    )
    longer = run({A: Outcome.HELD, C: Outcome.HELD}, evaluations=2, method="custom_contact")
    names = [reference_set_of(each).origin.runs for each in (one, other, copy, longer)]
    assert names[0] == names[2] == names[3] != names[1]
    histories = list(read_histories([one, other, copy], ReferenceLookup(())))
    kept, copies = distinct_searches(histories)
    assert ([run.path for run in kept], [run.path for run in copies]) == ([one.path, other.path], [copy.path])


def test_a_run_without_a_success_may_be_added_to_a_set_as_one_that_found_nothing(run, tmp_path) -> None:
    out = tmp_path / "set.npz"
    build_reference_sets([run({A: HELD})], out)
    build_reference_sets([run({A: Outcome.MISSED}, seed=1)], out)
    assert incidence(out) == {A: [0, 3]}


def test_runs_that_score_given_poses_are_refused(tmp_path: Path) -> None:
    poses = ((0.0,) * 6 + (1.0,),)
    scored = record(tmp_path / "scored", made_scene(), rows_of({A: HELD}), method="given", poses=poses)
    with pytest.raises(InputError, match=r"scores given poses, which were found elsewhere"):
        build_reference_sets([scored], tmp_path / "set.npz")


def test_a_set_that_is_older_serves_coverage_and_is_not_added_to(run: Runs, tmp_path: Path) -> None:
    out, first = tmp_path / "set.npz", run({A: HELD})
    build_reference_sets([first], out)
    with np.load(out) as arrays:
        older = {name: arrays[name] for name in arrays if not name.endswith(("runs", "by_run"))}
    np.savez(out, **older)
    known = read_reference(out, "block")
    assert (known.origin is None, known.estimate, known.robust.estimate) == (False, None, None)
    assert known.estimate_words().startswith("The set does not say which run found which cell")
    before = out.read_bytes()
    with pytest.raises(AssetError, match=r"does not say which run found which cell, .*build it anew"):
        build_reference_sets([first], out)
    assert out.read_bytes() == before


def test_a_file_that_could_not_be_read_again_is_not_written(run, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(reference_builder, "LARGEST_ARRAYS", 1000)
    with pytest.raises(InputError, match=r"would hold .* bytes of arrays"):
        build_reference_sets([run({A: HELD})], tmp_path / "set.npz")
    assert not [*tmp_path.glob("*.npz")]


def test_one_file_holds_several_objects_of_a_gripper(run: Runs, tmp_path: Path) -> None:
    out = tmp_path / "set.npz"
    build_reference_sets([run({A: Outcome.HELD})], out)
    sets = build_reference_sets([run({B: Outcome.HELD}, object_="ycb_mug", com=0.01)], out)
    assert list(sets) == ["mug"]
    assert groups(out) == {A: 2}
    assert groups(out, "mug") == {B: 2}


def test_no_set_is_made_of_runs_without_a_success(run: Runs, tmp_path: Path) -> None:
    found, missed = run({A: Outcome.HELD}), run({A: Outcome.MISSED})
    other = run({A: Outcome.MISSED}, object_="cup.stl", com=0.01)
    for folders, name in (([missed], "block"), ([found, other], "cup")):
        with pytest.raises(
            InputError, match=f"no cell for a set of '{name}': no row of its runs is a success"
        ):
            build_reference_sets(folders, tmp_path / "set.npz")
        assert not (tmp_path / "set.npz").exists()
    build_reference_sets([missed, found], tmp_path / "set.npz")
    assert groups(tmp_path / "set.npz") == {A: 2}


def test_runs_that_do_not_belong_together_are_refused_and_the_file_stays(run: Runs, tmp_path: Path) -> None:
    out = tmp_path / "set.npz"
    first = run({A: Outcome.HELD})
    build_reference_sets([first], out)
    before = out.read_bytes()
    claw = run({B: Outcome.HELD}, gripper="claw")
    moved = run({B: Outcome.HELD}, com=0.01)
    released = run({B: Outcome.HELD}, protocol="released")
    for other, words in (
        (claw, r"one gripper, and these runs are with 'claw' and 'jaw'"),
        (moved, r"'block' are on different objects, 'block.stl' and 'block.stl'"),
        (released, r"different evaluation protocols, 'paper' and 'released'.*--mixed"),
    ):
        for folders, file in (([other], out), ([first, other], tmp_path / "new.npz")):
            with pytest.raises(InputError, match=words):
                build_reference_sets(folders, file)
    assert out.read_bytes() == before
    assert not (tmp_path / "new.npz").exists()


def test_protocols_are_mixed_where_that_is_asked_for_and_the_file_remembers(run, tmp_path) -> None:
    out = tmp_path / "set.npz"
    runs = [run({A: Outcome.DROPPED}), run({A: Outcome.SHAKEN}, protocol="released")]
    build_reference_sets(runs, out, mixed=True)
    build_reference_sets(runs[:1], out)
    known = read_references(out)["block"]
    assert known.origin is not None
    assert (known.origin.protocols, known.fitness.tolist()) == (("paper", "released"), [1])


def test_a_set_that_does_not_say_what_it_was_built_from_is_not_added_to(run: Runs, tmp_path: Path) -> None:
    out = tmp_path / "S_G.npz"
    np.savez(out, **{"block.cm": np.array([A], np.int16), "block.fitness": np.array([1], np.uint8)})
    before = out.read_bytes()
    with pytest.raises(AssetError, match=r"S_G.npz' does not say what"):
        build_reference_sets([run({B: Outcome.HELD})], out)
    assert out.read_bytes() == before
    assert list(tmp_path.glob(".*")) == []


def test_nothing_but_the_file_is_left_beside_it(run: Runs, tmp_path: Path) -> None:
    (tmp_path / "sets").mkdir()
    build_reference_sets([run({A: Outcome.HELD})], tmp_path / "sets" / "own.npz")
    assert [path.name for path in (tmp_path / "sets").iterdir()] == ["own.npz"]


def test_the_folder_of_a_set_is_made(run: Runs, tmp_path: Path) -> None:
    build_reference_sets([run({A: Outcome.HELD})], tmp_path / "new" / "set.npz")
    assert groups(tmp_path / "new" / "set.npz") == {A: 2}


def test_an_object_is_known_by_its_mesh_and_centre_of_mass() -> None:
    body = made_scene().object
    change = msgspec.structs.replace
    assert object_identity(body) == object_identity(change(body, name="part", mass=2.0, lateral_friction=1.0))
    others = [
        change(body, com_in_mesh=(0.0, 0.0, 1e-9)),
        change(body, mesh_vertices=body.mesh_vertices[:-1] + b"x"),
        change(body, mesh_faces=body.mesh_faces[12:]),
    ]
    assert len({object_identity(other) for other in (body, *others)}) == 4


def test_a_run_is_compared_with_a_set_of_its_own_object(run: Runs, tmp_path: Path) -> None:
    out, first = tmp_path / "set.npz", run({A: Outcome.HELD, B: Outcome.DROPPED})
    done = CliRunner().invoke(
        app, ["reference", "build", str(first.path), "--out", str(out), "--name", "part"]
    )
    assert done.output == (
        f"{out} holds 2 cells of 'part', 1 of them robust, from 1 run.\n"
        "  The set is of 1 run, so that there is no estimate of the cells that it lacks.\n"
    )
    second = run({A: Outcome.SHAKEN, C: Outcome.HELD}, seed=1)
    asked = ["coverage", str(second.path), "--reference", str(out), "--object", "part", "--json"]
    found = msgspec.json.decode(CliRunner().invoke(app, asked).output)
    assert (found["found"], found["size"], found["outside"], found["stand_in"]) == (1, 2, 1, False)
    assert (found["built_from"], found["estimate"], found["robust_estimate"]) == (False, None, None)
