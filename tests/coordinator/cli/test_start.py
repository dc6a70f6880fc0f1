"""What the command line loads before it knows which command it is to carry out."""

import json
import subprocess
import sys

import pytest

HEAVY = {"coacd", "embreex", "matplotlib", "numba", "ribs", "scipy", "sklearn", "trimesh"}
"""What takes a tenth of a second or more to import; commands import it where they need it."""


@pytest.mark.parametrize("module", ["main", "coordinator", "recorder"])
def test_a_command_line_loads_nothing_heavy_before_its_command_runs(module):
    statements = f"import json, sys, qdgrasp_coordinator.cli.{module}; print(json.dumps(sorted(sys.modules)))"
    said = subprocess.run([sys.executable, "-c", statements], capture_output=True, check=True, text=True)
    assert not HEAVY & set(json.loads(said.stdout))
