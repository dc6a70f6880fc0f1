"""Scenes that a worker keeps on disk."""

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.worker.serving.office import Office

from qdgrasp_protocol.local_bus import LocalNetwork
from qdgrasp_worker.serving import bundles
from qdgrasp_worker.serving.bundles import Bundles

SCENE = b"a scene"


@pytest.fixture
def office() -> Iterator[Office]:
    with Office(LocalNetwork(), scene=SCENE) as office:
        yield office


def keep(folder: Path, payload: bytes, used: int) -> str:
    """Have a scene on disk that was used then [ns]; gives its digest."""
    digest = hashlib.sha256(payload).hexdigest()
    (folder / digest).write_bytes(payload)
    os.utime(folder / digest, ns=(used, used))
    return digest


def test_a_full_disk_costs_no_scene_and_keeps_no_draft(office, tmp_path, monkeypatch):
    def full(self: Path, target: Path) -> Path:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    assert Bundles(tmp_path).bundle(office.bus, "job", office.digest) == SCENE
    assert list(tmp_path.iterdir()) == []


def test_scenes_that_were_used_long_ago_make_room_for_others(office, tmp_path, monkeypatch):
    monkeypatch.setattr(bundles, "MOST", 3 * len(SCENE))
    old, recent, reused = (keep(tmp_path, SCENE[:6] + end, 1 + i) for i, end in enumerate((b"1", b"2", b"3")))
    os.utime(tmp_path / reused, ns=(0, 0))
    cache = Bundles(tmp_path)
    cache.bundle(office.bus, "job", reused)
    cache.bundle(office.bus, "job", office.digest)
    assert {path.name for path in tmp_path.iterdir()} == {recent, reused, office.digest}
    assert old != recent
