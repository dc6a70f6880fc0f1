"""The table of constants in docs/methods.md, against the code."""

import ast
import re
from importlib import import_module
from importlib.util import find_spec
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest
from benchmarks.leave_one_out.grid import GRID
from tests.docs.pages import ROOT

PAGE = ROOT / "docs" / "methods.md"
SECTION = PAGE.read_text(encoding="utf-8").split("### Constants of the default search\n")[1].split("\n## ")[0]
LINE = re.compile(r"^\| `([\w.]+)` \| (.+?) \| `([\w/]+)` \| (.+?) \| (.+?) \| (.+?) \|$", re.MULTILINE)
ROWS = [found.groups() for found in LINE.finditer(SECTION)]
ROOMS = ("qdgrasp_coordinator", "qdgrasp_worker", "qdgrasp_assets")
WHOLE = (
    "search/value_search", "search/frontier", "search/success_model", "search/aimed",
    "priors/aimed", "candidate_ranking", "swept_volume", "genes",
)  # fmt: skip
"""Modules of which each number is named."""
NO_CHOICE = {
    "ROLL", "LOOSENESS", "CANDIDATES", "FIRST_WEIGHT", "OMEGA", "NO_SLOT", "FIRST_CAPACITY", "NO_FINGER",
    "POSES_AT_ONCE", "VOLUMES_KEPT", "NEIGHBOURS", "BLOCK", "ANYWHERE",
}  # fmt: skip
"""Places of genes, marks, sizes of memory, steps to neighbours, and bounds that bind nothing."""


def path(module: str) -> str:
    """The full name of a module of the table."""
    names = [f"{room}.{module.replace('/', '.')}" for room in ROOMS]
    (only,) = [name for name in names if find_spec(name.rpartition(".")[0]) and find_spec(name)]
    return only


def numbers(module: str) -> set[str]:
    """The names of the numbers, and rows of numbers, that a module defines."""
    loaded = import_module(path(module))
    tree = ast.parse(Path(str(loaded.__file__)).read_text(encoding="utf-8"))
    targets = [target for node in tree.body if isinstance(node, ast.Assign) for target in node.targets]
    names = [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
    return {name for name in names if name.isupper() and np.asarray(getattr(loaded, name)).dtype.kind in "if"}


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row[2]} {row[0]}")
def test_a_constant_of_the_table_is_that_of_the_code(row: tuple[str, ...]) -> None:
    name, value, module = row[:3]
    found = attrgetter(name)(import_module(path(module)))
    assert np.array_equal(np.asarray(found), np.asarray(ast.literal_eval(value)))


@pytest.mark.parametrize("module", WHOLE)
def test_every_number_of_a_module_of_the_search_is_named(module: str) -> None:
    named = {row[0] for row in ROWS if row[2] == module} | set(
        re.findall(r"`([A-Z_]+)`", SECTION.split("\n- ", 1)[1])
    )
    assert numbers(module) - NO_CHOICE - named == set()


def test_a_record_that_the_table_names_has_that_section() -> None:
    links = {link for row in ROWS for link in re.findall(r"\]\((.*?)#(.*?)\)", row[5])}
    assert links
    for file, anchor in links:
        page = PAGE.parent / file if file else PAGE
        heads = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
        assert anchor in {re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-") for head in heads}, (
            file,
            anchor,
        )


def test_what_is_varied_to_refit_it_is_in_the_table_with_todays_value() -> None:
    known = {row[0]: ast.literal_eval(row[1]) for row in ROWS}
    assert {name: known[name] for name in GRID} == {name: one.today for name, one in GRID.items()}
