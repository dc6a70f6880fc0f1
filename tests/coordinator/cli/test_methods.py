"""`qdgrasp methods`."""

import json

from typer.testing import CliRunner

from qdgrasp_coordinator.cli.main import app
from qdgrasp_coordinator.searches.search import METHODS
from qdgrasp_protocol.spec import DEFAULT_METHOD


def test_every_method_has_a_line() -> None:
    done = CliRunner().invoke(app, ["methods"])
    assert done.exit_code == 0
    head, *lines = done.stdout.splitlines()
    assert head.split() == ["name", "prior", "overlaps", "population", "generations_in_flight", "summary"]
    assert [line.split()[0] for line in lines] == list(METHODS)


def test_the_default_comes_first_and_is_marked() -> None:
    assert next(iter(METHODS)) == DEFAULT_METHOD
    assert [name for name, entry in METHODS.items() if "default" in entry.summary] == [DEFAULT_METHOD]


def test_machines_get_the_same_table() -> None:
    table = json.loads(CliRunner().invoke(app, ["methods", "--json"]).stdout)
    assert {entry["name"]: entry["prior"] for entry in table} == {
        name: entry.prior for name, entry in METHODS.items()
    }
    assert next(entry for entry in table if entry["name"] == "cma_mae")["population"] == 540
