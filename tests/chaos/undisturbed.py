"""What a run gives that nobody disturbs: computed once for each spec and each state of the source."""

import hashlib
import shutil
from itertools import takewhile
from pathlib import Path

from tests.chaos.process import ROOT, Process

from qdgrasp_coordinator.folders.digest import digest
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_protocol.spec import RunSpec, to_toml

ROOMS = ("assets", "coordinator", "protocol", "worker")
DIGEST, RUN = "digest", "run"


def undisturbed_digest(spec: RunSpec, store: Path) -> str:
    """The digest of `qdgrasp run` with two workers and nobody else; kept in a folder of `store`."""
    home = store / _key(spec)
    known = home / DIGEST
    if not known.is_file():
        shutil.rmtree(home, ignore_errors=True)
        home.mkdir(parents=True)
        known.write_text(_carried_out(spec, home))
    return known.read_text()


def agreeing_rows(run: Path, spec: RunSpec, store: Path) -> tuple[int, int]:
    """How many rows of a run are recorded, and how many of them the undisturbed run begins with."""
    with RunFolder.open(run).journal() as some, RunFolder.open(store / _key(spec) / RUN).journal() as all_:
        pairs = zip(some.rows(0, some.count), all_.rows(0, some.count), strict=False)
        return some.count, sum(
            1 for _ in takewhile(lambda pair: pair[0].tobytes() == pair[1].tobytes(), pairs)
        )


def recorded_digest(run: Path) -> str:
    """What `qdgrasp digest` prints, without a process for it."""
    with RunFolder.open(run).journal() as journal:
        return digest(journal)


def _carried_out(spec: RunSpec, home: Path) -> str:
    file, run = home / "spec.toml", home / RUN
    file.write_text(to_toml(spec))
    command = ("run", file, "--workers", 2, "--out", run)
    process = Process("run", "qdgrasp", command, home / "log")
    process.start()
    assert process.wait() == 0, process.words
    return recorded_digest(run)


def _key(spec: RunSpec) -> str:
    """A name for a spec and the packages that carry it out, with the hands and objects in them."""
    key = hashlib.sha256(to_toml(spec).encode())
    for file in package_files(ROOT):
        content = hashlib.sha256(file.read_bytes()).hexdigest()
        key.update(f"{file.relative_to(ROOT)} {content}\n".encode())
    return key.hexdigest()[:16]


def package_files(root: Path) -> list[Path]:
    """All files of the packages: source, URDF, TOML, meshes, and whatever else; none that Python wrote."""
    found = [file for room in ROOMS for file in (root / room).rglob("*") if file.is_file()]
    return sorted(file for file in found if "__pycache__" not in file.parts)
