"""`coverage` of a reference set by a run."""

import json
from pathlib import Path

import numpy as np
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import made_scene
from typer.testing import CliRunner

from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.cli.main import app


def test_a_run_covers_the_share_of_a_set_that_it_has_found(tmp_path: Path) -> None:
    rows = random_rows(80, 0, 0.02)
    record(tmp_path / "run", made_scene(), rows, object="block")
    successes = rows[rows["outcome"] >= Outcome.DROPPED]
    reached = np.unique(cells(successes["base_to_object"][:, :3]), axis=0).astype(np.int16)
    known = np.concatenate([reached[::2], reached[::2] + 50])
    np.savez(tmp_path / "own.npz", **{"block.cm": known, "block.fitness": np.zeros(len(known), np.uint8)})

    command = ["coverage", str(tmp_path / "run"), "--reference", str(tmp_path / "own.npz")]
    done = CliRunner().invoke(app, [*command, "--object", "block", "--json"], catch_exceptions=False)

    found = json.loads(done.output)
    assert (found["size"], found["found"], found["coverage"]) == (len(known), len(known) // 2, 0.5)
    assert found["outside"] == len(reached) - found["found"]
