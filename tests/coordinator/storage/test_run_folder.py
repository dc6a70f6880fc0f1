import os
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_coordinator.storage.journal import JournalIdentity
from qdgrasp_coordinator.storage.journal_writer import JournalWriter
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.rows import RowShape
from qdgrasp_protocol.spec import RunSpec

SPEC = RunSpec(gripper="panda", object="mug")
BUNDLE = Bundle(b"scene", "7ac9b4c4f4f4ab3e9b0c0cd1b4a3a7ef5a3dc1e4e2b2f7a6d0c5b8d2a1e0f9c8")


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return RunFolder.create(tmp_path / "My run 1", SPEC, BUNDLE)


def test_a_new_folder_holds_the_spec_the_scene_and_the_job(folder: RunFolder) -> None:
    again = RunFolder.open(folder.path)
    assert again.spec == SPEC
    assert again.bundle().payload == b"scene"
    assert (again.job.name, again.job.epoch) == ("my-run-1", 0)
    assert again.job.logs.is_dir()
    assert sorted(entry.name for entry in folder.path.parent.iterdir()) == ["My run 1"]


def test_another_run_is_never_overwritten_and_its_resume_is_named(folder: RunFolder) -> None:
    for refuse in (RunFolder.check_free, lambda path: RunFolder.create(path, SPEC, BUNDLE)):
        with pytest.raises(FolderError, match=f"`qdgrasp resume {folder.path}`"):
            refuse(folder.path)


def test_no_run_is_begun_in_the_folder_of_another(folder: RunFolder) -> None:
    with pytest.raises(FolderError, match=f"would lie in {folder.path}, the folder of a run"):
        RunFolder.check_free(folder.path / "new" / "run")
    RunFolder.check_free(folder.path / ".." / "new")


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FolderError, match="holds no run"):
        RunFolder.open(tmp_path)
    with pytest.raises(FolderError, match="There is no folder"):
        RunFolder.open(tmp_path / "nowhere")


def test_a_creation_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(source: Path, target: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "rename", full)
    with pytest.raises(FolderError, match="no room to write"):
        RunFolder.create(tmp_path / "run", SPEC, BUNDLE)
    assert list(tmp_path.iterdir()) == []


def test_a_job_has_an_identity_that_no_other_of_its_name_has(folder: RunFolder, tmp_path: Path) -> None:
    again = JobFolder.create(tmp_path / "campaign", folder.job.name)
    assert len({folder.job.identity, again.identity, ""}) == 3
    before = again.identity
    again.set_epoch(2)
    assert again.identity == before


def recorded(folder: RunFolder, spec: RunSpec = SPEC) -> RunFolder:
    """The folder with a journal."""
    identity = JournalIdentity("run", spec, folder.bundle().digest, RowShape(7, 2))
    JournalWriter.create(folder.path, identity).close()
    return folder


def test_a_journal_is_its_folder_s_own_with_any_budget_and_without_its_scene(folder: RunFolder) -> None:
    recorded(folder).rewrite_spec(msgspec.structs.replace(SPEC, evaluations=20_000))
    with (folder.path / "spec.toml").open("a") as spec:
        spec.write("# a note\n")
    folder.journal().close()
    (folder.path / "scene.bundle").unlink()
    folder.journal().close()


HOLD = """
import sys; from pathlib import Path; from qdgrasp_coordinator.storage.job_folder import hold_lock
with hold_lock(Path(sys.argv[1])):
    print("held", flush=True); sys.stdin.read()
"""


def test_one_process_at_a_time_and_its_death_frees_the_folder(folder: RunFolder) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder.path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as holder:
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(FolderError, match=f"in use by process {holder.pid}"):
            folder.job.check_not_in_use()
        with pytest.raises(FolderError, match=f"in use by process {holder.pid}"), folder.job.lock():
            pass
        holder.kill()
        holder.wait()
    folder.job.check_not_in_use()
    with folder.job.lock(), pytest.raises(FolderError, match=f"in use by process {os.getpid()}"):
        folder.job.check_not_in_use()
