"""Rules of the whole repository: its papers, its silenced checks, and no unpickling."""

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

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
    ("extra", "heading"),
    [
        *((extra, "of the extras export and monitor only") for extra in ("export", "monitor")),
        ("dev", "for tests and checks only"),
        ("docs", "for the documentation site only"),
        ("gpu", "for the engine mujoco-warp only"),
    ],
)
def test_every_package_that_tests_or_the_site_need_stands_in_the_notices(extra: str, heading: str) -> None:
    needed = tomllib.loads(read("pyproject.toml"))["project"]["optional-dependencies"][extra]
    names = {re.split(r"[<>=!~ \[;]", requirement)[0] for requirement in needed} - {"qdgrasp"}
    noticed = read("THIRD_PARTY_NOTICES.md").partition(f"## Packages {heading}")[2].partition("\n## ")[0]
    assert {name for name in names if not re.search(rf"\b{re.escape(name)} \(", noticed)} == set()


def test_the_citation_names_the_version_of_the_package() -> None:
    version = tomllib.loads(read("pyproject.toml"))["project"]["version"]
    assert f"\nversion: {version}\n" in read("CITATION.cff")
    assert f"\n## {version}" in read("CHANGELOG.md")


ROOMS = ("assets", "coordinator", "protocol", "worker")
SILENCED = re.compile(r"# (noqa|type: ignore)\b")
WITH_REASON = re.compile(r"# (noqa: [A-Z0-9, ]+|type: ignore\[[a-z, -]+\])  # \S")


def test_every_silenced_check_has_its_reason() -> None:
    lines = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for room in ROOMS
        for path in sorted((ROOT / room).rglob("*.py"))
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if SILENCED.search(line) and not WITH_REASON.search(line)
    ]
    assert not lines


MODULES = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]
RUN_WHAT_THEY_READ = {"pickle", "cloudpickle", "dill", "joblib", "marshal", "shelve", "yaml"}
UNPACKERS = {"messages.py", "scene.py"}
YAML = "yaml_files.py"
"""The one module that reads YAML, by its safe loader."""


def calls(path: Path) -> Iterator[tuple[str, ast.Call]]:
    """The calls in a module, by the last name of what is called."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            yield name, node


def imported(path: Path) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        if isinstance(node, ast.ImportFrom):
            found.add((node.module or "").partition(".")[0])
    return found


@pytest.mark.parametrize("room", ROOMS)
def test_no_module_imports_what_runs_what_it_reads(room: str) -> None:
    modules = [path for path in MODULES if path.is_relative_to(ROOT / room)]
    assert len(modules) > 5
    assert [path for path in modules if imported(path) & RUN_WHAT_THEY_READ and path.name != YAML] == []


def test_nothing_is_evaluated() -> None:
    built_in = [
        (path.name, node.func.id)
        for path in MODULES
        for _, node in calls(path)
        if isinstance(node.func, ast.Name) and node.func.id in {"eval", "exec", "compile", "__import__"}
    ]
    assert built_in == []


def test_arrays_are_loaded_without_pickles() -> None:
    loads = [
        node
        for path in MODULES
        for name, node in calls(path)
        if name == "load" and isinstance(node.func, ast.Attribute) and ast.unparse(node.func.value) == "np"
    ]
    assert len(loads) >= 2
    for node in loads:
        said = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
        assert said.get("allow_pickle") == "False"


def test_two_modules_unpack_and_both_say_how_much() -> None:
    found = [
        (path.name, node) for path in MODULES for name, node in calls(path) if name in {"unpackb", "Unpacker"}
    ]
    assert {name for name, _ in found} == UNPACKERS
    assert all(node.keywords for _, node in found)
