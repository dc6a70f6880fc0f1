"""`qdgrasp rerank`, `prune`, `jobs` and orders to a job: their output and refusals."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from tests.coordinator.recorded_runs import random_rows, record, record_spec
from tests.coordinator.scenes import made_scene
from tests.tools.monitor.sample_jobs import values, views
from typer.testing import CliRunner, Result

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import pack_scene
from qdgrasp_coordinator.metrics.grasp_quality import NO_LIMITS
from qdgrasp_coordinator.storage.journal import JournalIdentity, JournalSlice
from qdgrasp_coordinator.storage.journal_writer import JournalWriter
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol import messages
from qdgrasp_protocol.build_messages import MeshPreparation
from qdgrasp_protocol.errors import InputError, NoReply
from qdgrasp_protocol.messages import Order, OrderReply
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.rows import Outcome, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.cli import job_commands, run_commands
from qdgrasp_tools.cli.main import app
from qdgrasp_tools.local.supervisor import LocalJobConfig

SPEC = RunSpec(gripper="panda", object="tennis_ball", mass=0.07, method="contact_me_scs", seed=5, grasps=9)


@pytest.fixture
def source(tmp_path: Path) -> RunFolder:
    """A run that has recorded a success, and no grasp."""
    scene = build_scene(SPEC)
    bundle = pack_scene(scene)
    folder = RunFolder.create(tmp_path / "source", SPEC, bundle)
    shape = RowShape(len(layout(scene, "contact")), len(scene.gripper.joints))
    rows = shape.empty(3)
    rows["index"], rows["outcome"] = np.arange(3), [Outcome.OVERLAP, Outcome.DROPPED, Outcome.MISSED]
    rows["base_to_object"][:, 6] = 1
    with JournalWriter.create(folder.path, JournalIdentity("run", SPEC, bundle.digest, shape)) as journal:
        journal.append(JournalSlice(0, rows), 1, 0.0)
    return folder


def rerank(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["rerank", *map(str, arguments)])


def test_a_run_without_a_grasp_has_nothing_to_score_again(source: RunFolder, tmp_path: Path) -> None:
    refused = rerank(source.path, "--out", tmp_path / "again").exception
    assert isinstance(refused, InputError)
    assert "has found no grasp (fitness 1 or more)" in str(refused)
    assert not (tmp_path / "again").exists()


@pytest.mark.parametrize(("hand", "seats"), [("panda", (0,)), ("allegro", None)])
def test_a_jaw_alone_closes_from_where_it_settled_if_it_rests_there_and_the_best_few_go_on(
    hand, seats, tmp_path, monkeypatch
):
    spec = msgspec.structs.replace(SPEC, gripper=hand, protocol="physical", grasps=None)
    scene = build_scene(spec)
    shape = RowShape(len(layout(scene, "contact")), len(scene.gripper.joints), scene.contact_slots)
    rows = shape.empty(6)
    rows["index"], rows["outcome"], rows["fitness"] = np.arange(6), Outcome.HELD, 6
    rows["base_to_object"][:, 6] = rows["settled"][:, 6] = 1
    rows["descriptor"][:, 0] = rows["base_to_object"][:, 0] = np.arange(6) / 10
    rows["settled"][:, 0] = np.arange(6) / 10 + np.arange(1, 7) / 1000  # the first moved least
    source = record_spec(tmp_path / "source", spec, rows, pack_scene(scene))
    asked: list[int | None] = []
    made: list[RunSpec] = []

    def scored(spec: RunSpec, prepared: object, genomes: NDArray[np.float32], *_: object) -> Rows:
        asked.append(spec.trials)
        found = RowShape(7, len(scene.gripper.joints), scene.contact_slots).empty(len(genomes))
        found["index"], found["outcome"] = np.arange(len(genomes)), Outcome.HELD
        found["base_to_object"][:, 6] = found["settled"][:, 6] = 1
        if spec.trials == 1:
            found["outcome"][4] = Outcome.OVERLAP
            found["settled"][2, 0] = 0.001  # it slips on
        again = np.repeat(found[found["outcome"] == Outcome.HELD], spec.trials)
        again["trial"] = 1
        again["fitness"] = np.round(10 * genomes[again["index"], 0])  # the last is the best
        return np.concatenate([found, again])

    monkeypatch.setattr(run_commands, "score_genomes", scored)
    monkeypatch.setattr(run_commands, "start_run", lambda spec, *_: made.append(spec))
    values, config = {"protocol": "robust", "trials": 100}, LocalJobConfig(1)
    for reseat in (True, False):
        run_commands.score_again(source, tmp_path / "out", config, values, NO_LIMITS, 2, 6, reseat=reseat)
    seated, plain = made
    assert asked == [*([1] if seats else []), 4, 10, 4, 10]
    assert (seated.trials, seated.base, seated.reseated) == (120, "physical", seats)
    assert [pose[0] for pose in seated.poses] == pytest.approx([0.506 if seats else 0.5, 0.4])
    assert plain.reseated is None
    assert [pose[0] for pose in plain.poses] == pytest.approx([0.5, 0.4])


EVIL = "\x1b[2J"


@contextmanager
def session(*_: object, **__: object) -> Iterator[SimpleNamespace]:
    """A session at a coordinator whose answer holds control characters."""
    yield SimpleNamespace(ask=lambda *_, **__: messages.encode(OrderReply(words=f"Done. {EVIL}")))


def test_what_a_coordinator_says_of_its_job_is_escaped(monkeypatch, capsys) -> None:
    monkeypatch.setattr(job_commands.ZenohBus, "connect", session)
    monkeypatch.setattr(job_commands, "reachable_jobs", lambda _: views(values(trouble=EVIL)))
    job_commands.jobs(connect="tcp/127.0.0.1:1")
    said = capsys.readouterr().out
    assert r"paused: \x1b[2J" in said
    assert EVIL not in said


def test_a_job_that_answers_late_is_known_and_may_still_carry_an_order_out(monkeypatch) -> None:
    def silent(*_: object, **__: object) -> None:
        raise NoReply("no answer")

    @contextmanager
    def waiting(*_: object, **__: object) -> Iterator[SimpleNamespace]:
        yield SimpleNamespace(ask=silent)

    monkeypatch.setattr(job_commands.ZenohBus, "connect", waiting)
    monkeypatch.setattr(job_commands, "reachable_jobs", lambda _: views(values()))
    (known,) = views(values())
    for job, words in (
        (known.job, "did not answer in time, and may still"),
        ("other", "Unknown job 'other'"),
    ):
        with pytest.raises(InputError, match=words):
            job_commands.send_order(job, "tcp/127.0.0.1:1", None, Order(act="pause"))


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ("--set trials=10", "trials = 10 is for the protocol 'robust'"),
        ("--protocol robust --set trials=some", "trials must be"),
        ("--set sed=1", "Unknown key 'sed'. Did you mean 'seed'?"),
        ("--set seed", "seed must be a whole number at least 0, got ''"),
        ("--set poses=1", "Unknown key 'poses'"),
        ("--mesh remesh,hull", "give one of them|take one of them"),
        ("--resting-pose all", "resting_pose must be"),
    ],
)
def test_flags_that_cannot_be_are_refused(flags: str, words: str) -> None:
    done = CliRunner().invoke(app, ["run", "--gripper", "panda", "--object", "mug", *flags.split()])
    assert isinstance(done.exception, InputError)
    assert re.search(words, str(done.exception))


def test_flags_and_set_give_the_keys_of_a_spec(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    found: list[RunSpec] = []
    monkeypatch.setattr(run_commands, "start_run", lambda spec, *_: found.append(spec))
    mesh = tmp_path / "part.stl"
    line = f"--gripper panda --object {mesh} --mass 0.3 --units mm --mesh glued,simplify=900 --seed 4 "
    line += (
        "--set population=7 --set base=physical --protocol robust --set overlaps=redraw --resting-pose any"
    )
    CliRunner().invoke(app, ["run", *line.split()], catch_exceptions=False)
    (spec,) = found
    assert (spec.scale, spec.seed, spec.population, spec.base) == (0.001, 4, 7, "physical")
    assert spec.mesh == MeshPreparation(glued=True, simplify=900)
    assert (spec.overlaps, spec.resting_pose) == ("redraw", "any")


ON_DEVICE = ("--gripper", "panda", "--object", "mug", "--protocol", "physical", "--engine", "mujoco-warp")


@pytest.mark.parametrize("given", [(), ("--workers", "2")])
def test_a_run_of_which_no_worker_would_have_the_engine_is_not_begun(tmp_path, monkeypatch, given) -> None:
    monkeypatch.delenv("QDGRASP_DEVICE", raising=False)
    refused = CliRunner().invoke(app, ["run", *ON_DEVICE, *given, "--out", str(tmp_path / "run")]).exception
    assert isinstance(refused, InputError)
    assert "The engine mujoco-warp needs a worker with a device: set QDGRASP_DEVICE=cuda" in str(refused)
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("errors", [0, 3])
def test_a_run_with_errors_says_so_at_its_end(tmp_path, capsys, errors: int) -> None:
    rows = random_rows(20)
    rows["outcome"] = Outcome.MISSED
    rows["outcome"][:errors] = Outcome.ERROR
    folder = record(tmp_path / "run", made_scene(), rows, evaluations=20 - errors)
    run_commands.print_result(folder, Stop())
    assert ("The simulator failed on 3 rows" in capsys.readouterr().out) == bool(errors)
