"""Golden texts of files, and of the metrics for Prometheus."""

import sqlite3
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.tools.monitor.sample_jobs import event, run, values, views

from qdgrasp_assets.scene import FORMAT as SCENE
from qdgrasp_coordinator.storage.journal import APPLICATION, FORMAT, JournalIdentity
from qdgrasp_coordinator.storage.journal_writer import JournalWriter
from qdgrasp_protocol.messages import VERSION as PROTOCOL
from qdgrasp_protocol.rows import COLUMNS, Outcome, RowShape
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.export.yaml_files import VERSION as ISAAC
from qdgrasp_tools.monitor.prometheus import exposition


def version_text() -> str:
    """The version numbers of what is written and sent, the outcomes, and the columns of a row."""
    versions = {
        "application_id": f"{APPLICATION:#x}",
        "journal": FORMAT,
        "scene": SCENE,
        "isaac grasp file": ISAAC,
        "protocol": PROTOCOL,
    }
    lines = [f"{name}: {number}" for name, number in versions.items()]
    lines += [f"outcome {outcome.value}: {outcome.name}" for outcome in Outcome]
    lines += [f"column {column.name}: {column.item} x {column.width}" for column in COLUMNS]
    return "\n".join(lines) + "\n"


def journal_text() -> str:
    """The tables of a `run.sqlite` that has no rows yet, and what it notes of its run."""
    with TemporaryDirectory() as folder:
        identity = JournalIdentity(
            "run", RunSpec(gripper="panda", object="mug"), "ab" * 32, RowShape(genes=2, joints=2)
        )
        JournalWriter.create(Path(folder), identity).close()
        with closing(sqlite3.connect(Path(folder) / "run.sqlite")) as database:
            numbers = [
                f"PRAGMA {name} = {database.execute(f'PRAGMA {name}').fetchone()[0]};"
                for name in ("application_id", "user_version", "page_size", "journal_mode")
            ]
            tables = [
                f"{sql};" for (sql,) in database.execute("SELECT sql FROM sqlite_schema WHERE sql > ''")
            ]
            notes = [
                f"-- meta: {name}" for (name,) in database.execute("SELECT name FROM meta ORDER BY name")
            ]
    return "\n".join([*numbers, *tables, *notes]) + "\n"


def metric_text() -> str:
    """The metrics of a job with two runs and a worker: names, types, help and labels."""
    (view,) = views(values(workers=1))
    runs = [run("a", outcomes={one.name.lower(): int(one) for one in Outcome}), run("b")]
    view.events[:] = [event(1), event(7)]
    view.runs[:] = runs
    return exposition([view])[0].decode()
