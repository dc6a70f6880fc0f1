"""The folder of a campaign: begun, or gone on with by a campaign that may have grown."""

from pathlib import Path

from qdgrasp_coordinator.campaigns.campaign import Campaign, read_campaign
from qdgrasp_coordinator.campaigns.campaign_runs import CampaignRuns
from qdgrasp_coordinator.campaigns.programme import Extent
from qdgrasp_coordinator.folders import disk
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.job_folder import Job, JobFolder
from qdgrasp_coordinator.folders.names import CAMPAIGN, LOGS, RUNS
from qdgrasp_coordinator.folders.outputs import OutFolder
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.phrases import counted


def begin(path: Path, asked: Campaign, job: str | None = None) -> Extent:
    """Have the folder at `path` hold the campaign that is asked for; it is made where there is none.

    Parameters
    ----------
    job
        The job's name for a new folder; None: the folder's name, reduced to the allowed characters.

    Returns
    -------
    extent
        How much there is to do, and what of it is done.

    Raises
    ------
    FolderError, EndsTooSoon
        The folder holds a single run, another job, other files, runs that are not asked for any more, or one
        that is asked for with another spec or with less than it has; or it is in use. It is left as it was.
    """
    if not JobFolder.is_job(path):
        OutFolder(path).check()
        RunFolder.check_outside(path)
        files = Job.begun(path, job).file | {CAMPAIGN: asked.toml.encode()}
        disk.create(path, files, folders=[LOGS, RUNS])
        return CampaignRuns(None, asked.runs).extent
    folder = open_campaign(path)
    if job not in (None, folder.name):
        raise FolderError(f"{path} is of job '{folder.name}', not '{job}'; leave --job out.")
    folder.check_not_in_use()
    _check_kept(folder, asked)
    extent = CampaignRuns(folder, asked.runs).extent
    _hold(folder, asked)
    return extent


def open_campaign(path: Path) -> JobFolder:
    """The folder of a campaign that was begun.

    Raises
    ------
    FolderError
        There is none at `path`.
    """
    folder = JobFolder.open(path)
    if not folder.is_campaign:
        raise FolderError(f"{path} holds a single run, no campaign; name the folder of a campaign.")
    return folder


def _check_kept(folder: JobFolder, asked: Campaign) -> None:
    """Check that every run that the folder's campaign has is asked for."""
    lost = [name for name in read_campaign(folder.path / CAMPAIGN).runs if name not in asked.runs]
    if lost:
        lacking = counted(len(lost), "run that is", "runs that are")
        raise FolderError(
            f"{folder.path} is of a campaign with {lacking} not asked for any more, such as "
            f"'{lost[0]}'; leave them in the file, or name another folder with --out. "
            f"`qdgrasp campaign {folder.path}` goes on with the campaign as it was."
        )


def _hold(folder: JobFolder, asked: Campaign) -> None:
    file = folder.path / CAMPAIGN
    if file.read_bytes() != asked.toml.encode():
        disk.replace(file, asked.toml.encode())
