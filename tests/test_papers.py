"""What the papers say of the house is so."""

import re
import tomllib
from pathlib import Path

import pytest
import typer

from qdgrasp_coordinator.cli.main import app
from qdgrasp_coordinator.searches.search import METHODS
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import COLUMNS

ROOT = Path(__file__).resolve().parents[1]
PAPERS = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]
LINK = re.compile(r"\]\((?!https?://)([^)#]+)")


def read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


@pytest.mark.parametrize("paper", PAPERS, ids=[str(paper.relative_to(ROOT)) for paper in PAPERS])
def test_links_between_papers_lead_somewhere(paper: Path) -> None:
    missing = [
        to for to in LINK.findall(paper.read_text(encoding="utf-8")) if not (paper.parent / to).exists()
    ]
    assert missing == []


def test_the_index_names_every_page() -> None:
    pages = {page.name for page in (ROOT / "docs").glob("*.md")} - {"index.md"}
    assert pages <= set(LINK.findall(read("docs/index.md")))


def test_every_package_that_a_run_needs_stands_in_the_notices() -> None:
    needed = tomllib.loads(read("pyproject.toml"))["project"]["dependencies"]
    names = {re.split(r"[<>=!~ \[;]", requirement)[0] for requirement in needed}
    noticed = {
        name for name in names if re.search(rf"^\| {re.escape(name)}\b", read("THIRD_PARTY_NOTICES.md"), re.M)
    }
    assert noticed == names


@pytest.mark.parametrize(
    ("extra", "heading"), [("dev", "tests and checks only"), ("docs", "the documentation site only")]
)
def test_every_package_that_tests_or_the_site_need_stands_in_the_notices(extra: str, heading: str) -> None:
    needed = tomllib.loads(read("pyproject.toml"))["project"]["optional-dependencies"][extra]
    names = {re.split(r"[<>=!~ \[;]", requirement)[0] for requirement in needed}
    noticed = read("THIRD_PARTY_NOTICES.md").partition(f"## Packages for {heading}")[2].partition("\n## ")[0]
    assert {name for name in names if not re.search(rf"\b{re.escape(name)} \(", noticed)} == set()


def test_the_readme_shows_commands_that_exist() -> None:
    commands = set(typer.main.get_command(app).commands)  # type: ignore[attr-defined]
    shown = set(re.findall(r"^qdgrasp (\w+)", read("README.md"), re.MULTILINE))
    assert len(shown) >= 7
    assert shown <= commands


def test_the_readme_shows_methods_that_exist() -> None:
    table = read("README.md").partition("| methods |")[2].partition("\n\n")[0]
    shown = re.findall(r"^\| (.*?) \|", table, re.MULTILINE)
    methods = {name for cell in shown for name in re.findall(r"`(\w+)`", cell)}
    assert len(methods) >= 5
    assert methods <= set(METHODS)


def test_the_outcomes_are_numbered_as_described() -> None:
    rows = re.findall(
        r"^\| `(\w+)`[^|]*\| (\d) \| (\w*) ?\| (\w*) ?\| (\w*) ?\| (\w*) ?\|", read("docs/protocols.md"), re.M
    )
    described = {name: (int(number), *(word == "yes" for word in words)) for name, number, *words in rows}
    assert described == {
        outcome.name: (outcome, outcome.is_simulated, outcome.is_success, outcome.is_grasp, outcome.is_robust)
        for outcome in Outcome
    }


def test_the_columns_of_a_row_are_described_in_their_order() -> None:
    table = read("docs/run-folder.md").partition("## A row")[2].partition("\n\nThe ")[0]
    cells = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    assert [name for cell in cells for name in re.findall(r"`(\w+)`", cell)] == [
        column.name for column in COLUMNS
    ]


def test_the_citation_names_the_version_of_the_package() -> None:
    version = tomllib.loads(read("pyproject.toml"))["project"]["version"]
    assert f"\nversion: {version}\n" in read("CITATION.cff")
    assert f"\n## {version}" in read("CHANGELOG.md")
