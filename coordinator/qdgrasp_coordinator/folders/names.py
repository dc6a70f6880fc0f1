"""What the files in the folder of a run or of a job are called, so that no output takes their place."""

from pathlib import Path

JOB, ENDPOINT, LOCK, SUPERVISED = "job.json", "endpoint", "lock", "supervised"
CAMPAIGN, LOGS, RUNS = "campaign.toml", "logs", "runs"
SPEC, SCENE, JOURNAL = "spec.toml", "scene.bundle", "run.sqlite"
SOURCE, RANKING = "source.json", "ranking.csv"
"""Of a run that scores the grasps of another one again."""
MARKS = (JOB, CAMPAIGN, SCENE, JOURNAL)
"""Each of them tells the folder of a run or of a job, also where others are missing."""
PARTS = frozenset(
    [*MARKS, ENDPOINT, LOCK, SUPERVISED, LOGS, RUNS, SPEC, SOURCE, RANKING]
    + [JOURNAL + suffix for suffix in ("-wal", "-shm")]
)


def is_part(path: Path) -> bool:
    """Whether a path is, or would be, one of the files and folders that make a run or a job."""
    return path.name in PARTS and any((path.absolute().parent / mark).exists() for mark in MARKS)
