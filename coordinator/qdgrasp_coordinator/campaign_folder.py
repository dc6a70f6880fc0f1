"""The folder of a campaign: begun, or gone on with by a campaign that may have grown."""

from pathlib import Path

from qdgrasp_coordinator import disk
from qdgrasp_coordinator.campaign import Campaign, read_campaign
from qdgrasp_coordinator.job_folder import CAMPAIGN, LOGS, RUNS, Job, JobFolder
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.keys import job_name


def begin(path: Path, asked: Campaign, job: str | None = None) -> JobFolder:
    """The folder at `path`, made where there is none; it holds the campaign that is asked for.

    Parameters
    ----------
    job
        The job's name for a new folder; None: the folder's name, reduced to the allowed characters.

    Raises
    ------
    FolderError
        The folder holds a single run, runs that are not asked for any more, or other files, or is in use.
    """
    if not JobFolder.is_job(path):
        disk.check_free(path)
        files = Job(job or job_name(path.absolute().name)).file | {CAMPAIGN: asked.toml.encode()}
        disk.create(path, files, folders=[LOGS, RUNS])
        return JobFolder(path)
    folder = JobFolder.open(path)
    if not folder.is_campaign:
        raise FolderError(f"{path} holds a single run, no campaign; name another folder with --out.")
    folder.check_not_in_use()
    _grow(folder, asked)
    return folder


def _grow(folder: JobFolder, asked: Campaign) -> None:
    """Have the folder's campaign hold what is asked for: what it held before, or more."""
    file = folder.path / CAMPAIGN
    lost = [name for name in read_campaign(file).runs if name not in asked.runs]
    if lost:
        raise FolderError(
            f"{folder.path} is of a campaign with {len(lost)} runs that are not asked for any more, such as "
            f"'{lost[0]}'; leave them in the file, or name another folder with --out."
        )
    if file.read_bytes() != asked.toml.encode():
        with disk.writing(folder.path):
            disk.write(file, asked.toml.encode())
