"""Programs that bring their own optimiser, or their own evaluator: with real processes on a real bus."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.common import PATIENCE, own_endpoint
from tests.system.commands import ROUTER, Commands, digest_of, says

import qdgrasp
from qdgrasp_assets.catalog import build_scene
from qdgrasp_protocol.errors import EndedEarly, InputError
from qdgrasp_protocol.session import Role
from qdgrasp_tools.security import SecurityFolder
from qdgrasp_worker.evaluator import Evaluator

SCENE = {"gripper": "panda", "object": "tennis_ball"}
ONE, TWO = qdgrasp.Place(workers=1), qdgrasp.Place(workers=2, batch_size=7)


@pytest.fixture
def commands(tmp_path: Path) -> Iterator[Commands]:
    with Commands(tmp_path) as started:
        yield started


@pytest.fixture(scope="module")
def evaluations() -> Iterator[qdgrasp.Evaluations]:
    with qdgrasp.Evaluations(prior="approach", place=ONE, **SCENE) as evaluations:
        yield evaluations


@pytest.fixture(scope="module")
def near(evaluations: qdgrasp.Evaluations) -> np.ndarray:
    """Genomes of which many are grasps."""
    genomes = np.random.default_rng(3).uniform(-1, 1, (40, len(evaluations.layout))).astype(np.float32)
    genomes[:20, 3:5] = (-1.0, -0.5)
    return genomes


class Steps:
    """Steps from the best so far; raises in a generation if it is told to."""

    def __init__(self, layout: qdgrasp.Layout, fails_in: int | None = None) -> None:
        self.best = np.zeros((0, len(layout)), np.float32)
        self.fails_in = fails_in
        self.told: list[int] = []

    def ask(self, generation: int) -> np.ndarray:
        random = np.random.default_rng([1, generation])
        if not len(self.best):
            return random.uniform(-1, 1, (30, self.best.shape[1]))
        parents = self.best[random.integers(len(self.best), size=30)]
        return np.clip(parents + random.normal(0, 0.2, parents.shape), -1, 1)

    def tell(self, generation: int, rows: qdgrasp.Rows) -> None:
        if generation == self.fails_in:
            raise ZeroDivisionError
        self.told.append(generation)
        self.best = rows["genome"][np.argsort(-rows["fitness"], kind="stable")[:5]]


def optimise(make: Callable[[qdgrasp.Layout], Steps], out: Path, **changes: Any) -> qdgrasp.Run:
    """A run with a search of a program's own: 140 evaluations by one worker."""
    values = {"evaluations": 140, "prior": "approach", "place": ONE} | SCENE
    return qdgrasp.optimise(make, out, **values | changes)


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory) -> qdgrasp.Run:
    """A run with a search of a program's own."""
    return optimise(Steps, tmp_path_factory.mktemp("mine") / "run")


# Evaluations.


def test_rows_are_those_of_the_simulator(evaluations: qdgrasp.Evaluations, near: np.ndarray) -> None:
    rows = evaluations.evaluate(near)
    with Evaluator(build_scene(evaluations.spec)) as evaluator:
        expected = evaluator.evaluate("approach", near, np.zeros(len(near), np.uint16)).rows
    assert (rows["outcome"] >= qdgrasp.Outcome.DROPPED).any()
    for column in ("genome", "outcome", "fitness", "base_to_object", "joints"):
        assert rows[column].tobytes() == expected[column].tobytes(), column


def test_two_scenes_of_a_pool_are_evaluated_at_once_with_the_rows_of_each(evaluations, near) -> None:
    other = qdgrasp.Evaluations(prior="approach", pool=evaluations, gripper="panda", object="bowl")
    futures = [
        each.submit(near[part]) for part in (slice(20), slice(20, 40)) for each in (evaluations, other)
    ]
    rows = [future.result(PATIENCE) for future in futures]
    for each, found in ((evaluations, rows[::2]), (other, rows[1::2])):
        for column in ("genome", "outcome", "fitness", "base_to_object", "joints"):
            expected = each.evaluate(near)[column]
            assert np.concatenate(found)[column].tobytes() == expected.tobytes(), column
    assert rows[0]["outcome"].tolist() != rows[1]["outcome"].tolist()
    assert len(other.evaluate(near[:0])) == 0
    with pytest.raises(InputError, match="in the with-block of the pool"), other:
        pass


@pytest.mark.slow
def test_poses_that_were_found_score_as_they_did(evaluations: qdgrasp.Evaluations, near: np.ndarray) -> None:
    rows = evaluations.evaluate(near)
    poses = rows["base_to_object"]
    scores = qdgrasp.evaluate(poses[:, :3], poses[:, 3:], place=ONE, **SCENE)
    assert scores["outcome"].tobytes() == rows["outcome"].tobytes()
    assert scores["joints"].tobytes() == rows["joints"].tobytes()


def test_a_job_that_is_cancelled_ends_the_waiting(commands: Commands) -> None:
    place = qdgrasp.Place(workers=0, job="lonely")
    with qdgrasp.Evaluations(prior="approach", place=place, **SCENE) as lonely:
        heard: list[BaseException] = []

        def wait() -> None:
            try:
                lonely.evaluate(np.zeros((1, 7)), timeout=PATIENCE)
            except EndedEarly as error:
                heard.append(error)

        waiting = threading.Thread(target=wait)
        waiting.start()
        done = commands("cancel", "lonely", "--connect", lonely.endpoint)
        waiting.join(PATIENCE)
    assert done.code == 0, done.err
    assert "cancelled" in str(heard[0])


@pytest.fixture
def secure(commands: Commands) -> qdgrasp.Place:
    """A router to which links are encrypted, and one worker there."""
    lab = SecurityFolder.create(commands.home / "lab", hosts=["127.0.0.1"], days=1)
    gate = lab.add(Role.ROUTER, "gate", hosts=["127.0.0.1"], days=1)
    endpoint = own_endpoint("tls")
    router = commands.start("--listen", endpoint, "--security", gate, module=ROUTER)
    says(router, "listening")
    return qdgrasp.Place(workers=1, connect=endpoint, security=lab.path)


@pytest.mark.slow
def test_encrypted_links_change_no_row_and_no_journal(secure, evaluations, near, mine, tmp_path) -> None:
    with qdgrasp.Evaluations(prior="approach", place=secure, **SCENE) as encrypted:
        assert encrypted.evaluate(near).tobytes() == evaluations.evaluate(near).tobytes()
    assert digest_of(optimise(Steps, tmp_path / "run", place=secure).path) == digest_of(mine.path)


# A search of one's own.


def test_a_run_with_a_search_of_ones_own_is_a_run(mine: qdgrasp.Run, commands: Commands) -> None:
    assert mine.spec.method == "custom_approach"
    assert mine.summary.evaluations == 140
    assert mine.summary.complete
    assert np.unique(mine.rows()["generation"]).tolist() == [0, 1, 2, 3, 4]
    assert "custom_approach" in commands.succeed("info", mine.path).out


def test_what_was_stopped_goes_on_where_it_was(mine: qdgrasp.Run, tmp_path: Path) -> None:
    out = tmp_path / "run"
    with pytest.raises(ZeroDivisionError):
        optimise(lambda layout: Steps(layout, fails_in=2), out)
    made: list[Steps] = []

    def make(layout: qdgrasp.Layout) -> Steps:
        made.append(Steps(layout))
        return made[-1]

    assert digest_of(optimise(make, out, resume=True).path) == digest_of(mine.path)
    assert made[0].told == [0, 1, 2, 3]
