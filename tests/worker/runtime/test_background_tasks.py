"""Shapes that a worker builds in a process of its own, from files that it fetches."""

import hashlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from queue import SimpleQueue

import pytest
import trimesh
from tests.common import PATIENCE, wait_for
from tests.fakes.memory_bus import MemoryNetwork

from qdgrasp_assets.code_version import building_code
from qdgrasp_assets.object_shape import ShapeStore, unpack_shape
from qdgrasp_protocol.build_messages import Build, MeshFile, ShapeTask
from qdgrasp_protocol.bus import Query, answer_file_chunk
from qdgrasp_protocol.errors import Refused
from qdgrasp_protocol.keys import Keys, last_chunk
from qdgrasp_worker.runtime import background_tasks
from qdgrasp_worker.runtime.background_tasks import BuildEnded, BuilderClient

JOB = "job"


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache folder."""
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def mesh(tmp_path: Path) -> Path:
    """A box of 5 cm."""
    path = tmp_path / "box.stl"
    trimesh.creation.box((0.05,) * 3).export(path)
    return path


def build_of(mesh: Path, code: str = "") -> Build:
    content = mesh.read_bytes()
    file = MeshFile(name="mesh.stl", sha256=hashlib.sha256(content).hexdigest(), size=len(content))
    task = ShapeTask(files=(file,), code=code or building_code())
    return Build(epoch=3, batch=bytes(16), attempt=1, join=1, task=task)


@contextmanager
def serving(*files: Path) -> Iterator[tuple[BuilderClient, "SimpleQueue[BuildEnded]"]]:
    """A builder, its news, and a coordinator that has these files."""
    network, news = MemoryNetwork(), SimpleQueue[BuildEnded]()
    by_digest = {hashlib.sha256(file.read_bytes()).hexdigest(): file for file in files}

    def answer(query: Query) -> bytes:
        if (file := by_digest.get(last_chunk(query.key))) is None:
            raise Refused("no run in progress has it")
        return answer_file_chunk(query, file)

    with ExitStack() as stack:
        head, here = (stack.enter_context(network.session()) for _ in range(2))
        stack.enter_context(head.answer(Keys(JOB).asset(), answer))
        client = BuilderClient(here, news.put)
        stack.callback(client.stop)
        yield client, news


def test_a_shape_is_built_from_files_that_come_over_the_bus_and_kept(mesh: Path) -> None:
    build = build_of(mesh)
    with serving(mesh) as (client, news):
        client.start(JOB, build)
        assert client.build is build
        ended = news.get(timeout=PATIENCE)
        assert client.on_ended(ended)
        assert client.build is None
    assert not ended.reason
    assert ended.cpu_seconds > 0
    assert unpack_shape(ended.shape) == ShapeStore().get(build.task.key)
    answer = ended.message("a" * 32, bytes(32))
    assert (answer.epoch, answer.batch, len(answer.pieces)) == (3, build.batch, 1)


def test_files_that_cannot_be_fetched_are_no_evidence_against_the_object(mesh: Path) -> None:
    with serving() as (client, news):
        client.start(JOB, build_of(mesh))
        ended = news.get(timeout=PATIENCE)
    assert ended.reason
    assert not ended.is_final


def test_a_mesh_that_cannot_be_used_is_final(tmp_path: Path) -> None:
    flat = tmp_path / "flat.stl"
    trimesh.Trimesh([(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0)], [(0, 1, 2)]).export(flat)
    with serving(flat) as (client, news):
        client.start(JOB, build_of(flat))
        ended = news.get(timeout=PATIENCE)
    assert ended.is_final
    assert "cannot be used: " in ended.message("a" * 32, bytes(32)).reason
    assert str(tmp_path) not in ended.reason


def test_a_builder_that_is_killed_ends_its_build_with_the_signal(mesh, monkeypatch) -> None:
    monkeypatch.setattr(background_tasks, "BUILDER", ["sh", "-c", "kill -9 $$"])
    with serving(mesh) as (client, news):
        client.start(JOB, build_of(mesh))
        ended = news.get(timeout=PATIENCE)
    assert (ended.reason, ended.is_final) == ("it was ended by SIGKILL", False)


def test_stopping_ends_the_process(mesh: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    monkeypatch.setattr(background_tasks, "BUILDER", ["sh", "-c", f"echo $$ > {mark}; exec sleep 1000"])
    with serving(mesh) as (client, news):
        client.start(JOB, build_of(mesh))
        wait_for(lambda: mark.is_file() and mark.read_text())
        client.stop()
        ended = news.get(timeout=PATIENCE)
        assert not client.on_ended(ended)
    assert ended.reason == "it was ended by SIGKILL"
