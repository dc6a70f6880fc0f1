"""Every command of the pages is run, or stands in a list with the reason why it is not."""

import re
import runpy
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
import typer
from tests.deploy.commands import COMMANDS, understood
from tests.docs import pages
from tests.docs.pages import PAGES, ROOT, Line, PageRun, blocks, words
from tests.docs.prepared import Prepared, assumed

SHELL = ("sh", "bash", "console")
IMPORT = re.compile(r"^(?:import|from) (\w+)", re.MULTILINE)
OTHERS = r"(sqlite3|curl|jq|cp) "
"""Programs of others that lines are run with, where they are installed."""
LINES = [line for page in PAGES for block in blocks(page, *SHELL) for line in block.lines]
OURS = [line for line in LINES if line.is_ours]


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def told(page: Path, *, whole: bool) -> list[list[Line]]:
    """The lines of a page that are run, block by block; long ones only if it is told whole."""
    found = [
        [line for line in block.lines if whole or not pages.LONG.match(line.text)]
        for block in blocks(page, *SHELL)
    ]
    return [[line for line in lines if not pages.reason(line.text)] for lines in found]


def scripts(page: Path) -> list[str]:
    """The Python of a page, but for what imports packages of others that are not installed."""
    found = [block.text for block in blocks(page, "python")]
    return [text for text in found if all(map(find_spec, IMPORT.findall(text)))]


SHORT_STORIES = [page for page in PAGES if any(told(page, whole=False)) or blocks(page, "python")]
LONG_STORIES = [page for page in PAGES if told(page, whole=True) != told(page, whole=False)]


@pytest.fixture(scope="session")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Prepared]:
    prepared = Prepared(tmp_path_factory.mktemp("prepared"))
    yield prepared
    prepared.commands.end_all()


@pytest.fixture
def story(prepared: Prepared, tmp_path: Path) -> Iterator[PageRun]:
    story = PageRun(tmp_path, prepared.home / "cache")
    yield story
    story.close()


def in_time(pages: list[Path]) -> list[object]:
    """Mark all pages but the README as slow; `make test-docs` reads them all."""
    return [
        page if page.name == "README.md" else pytest.param(page, marks=pytest.mark.slow) for page in pages
    ]


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("page", in_time(SHORT_STORIES), ids=name_of)
def test_the_short_commands_of_a_page_do_what_it_says(page: Path, prepared: Prepared, story: PageRun) -> None:
    tell(page, prepared, story, whole=False)
    (story.home / "of_the_page.py").write_text("\n".join(scripts(page)))
    done = subprocess.run(
        [sys.executable, "of_the_page.py"], cwd=story.home, capture_output=True, check=False, text=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.timeout(2400)
@pytest.mark.parametrize("page", LONG_STORIES, ids=name_of)
def test_all_commands_of_a_page_do_what_it_says(page: Path, prepared: Prepared, story: PageRun) -> None:
    tell(page, prepared, story, whole=True)


def tell(page: Path, prepared: Prepared, story: PageRun, *, whole: bool) -> None:
    """Carry a page out, in a folder with the files that it assumes."""
    lines = [line for lines in told(page, whole=whole) for line in lines]
    has_certificates = any("security init" in line.text for line in lines)
    if has_certificates and not any("security add" in line.text for line in lines):
        story.places["lab"] = "security"  # files that the page does not issue are not there
    texts = [pages.cut(line.text, story.places) for line in lines]
    needed = assumed([*texts, *scripts(page)])
    if "--security" in " ".join(texts) and not has_certificates:
        needed.append("security")
    for name in needed:
        prepared.give(name, story.home)
    for lines in told(page, whole=whole):
        story.tell(lines)


@pytest.mark.parametrize("line", [line for line in LINES if not line.is_ours], ids=str)
def test_a_line_of_another_program_is_run_or_listed(line: Line) -> None:
    assert pages.reason(line.text) or re.match(OTHERS, line.text), (
        "no rule says why this is not run; add one to tests/docs/pages.py"
    )


@pytest.mark.parametrize("line", OURS, ids=str)
def test_a_line_of_ours_is_one_that_the_commands_take(line: Line) -> None:
    if not line.text.startswith("python "):
        understood(words(line))


@pytest.mark.parametrize("pattern", pages.ELSEWHERE)
def test_a_reason_is_given_for_something(pattern: str) -> None:
    assert any(re.match(pattern, line.text) for line in LINES), "no line is like that any more"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_in_sentences_have_the_flags_that_they_are_given(page: Path) -> None:
    for said in pages.SPAN.findall(pages.FENCE.sub("", page.read_text(encoding="utf-8"))):
        program, *rest = said.replace("[", " ").replace("]", " ").split()
        assert program in COMMANDS, said
        command = typer.main.get_command(COMMANDS[program])
        for word in rest:
            if word in getattr(command, "commands", {}):
                command = command.commands[word]  # type: ignore[attr-defined]
        flags = {flag for option in command.params for flag in (*option.opts, *option.secondary_opts)}
        named = {word.partition("=")[0].rstrip(",.") for word in rest if word.startswith("-") and word != "-"}
        assert named <= flags | {"--help"}, said
        if program == "qdgrasp" and rest and re.fullmatch(r"[a-z]+", rest[0]):
            assert rest[0] in typer.main.get_command(COMMANDS[program]).commands, said  # type: ignore[attr-defined]


WEBSITE = ROOT / "docs" / "website"
FIRST = "docs/index.md"
"""The page that the sidebar is attached to; no entry of the sidebar leads to it."""
NEEDED = ("furo", "griffe", "myst_parser", "sphinx")
MISSING = [name for name in NEEDED if find_spec(name) is None]


def listed() -> list[str]:
    """The entries of the sidebar, as paths and patterns of the repository."""
    text = (WEBSITE / "navigation.toml").read_text(encoding="utf-8")
    return [name for section in tomllib.loads(text)["section"] for name in section["pages"]]


def found(entry: str) -> list[str]:
    return [str(path.relative_to(ROOT)) for path in ROOT.glob(entry)]


def test_the_navigation_has_every_page_of_docs_exactly_once() -> None:
    counts = Counter(name for entry in listed() for name in found(entry))
    assert {name: n for name, n in counts.items() if n > 1} == {}
    assert set(found("docs/**/*.md")) == {name for name in counts if name.startswith("docs/")} | {FIRST}


@pytest.mark.parametrize("entry", listed())
def test_an_entry_of_the_navigation_leads_to_a_page(entry: str) -> None:
    assert found(entry)


def test_dead_links_and_loads_from_the_network_are_faults(tmp_path: Path) -> None:
    page = (
        '<a href="b.html#here">good</a><a href="b.html#gone">no anchor</a><a href="c.html">no page</a>'
        '<a href="https://example.org">outside</a><script src="https://example.org/x.js"></script>'
    )
    (tmp_path / "a.html").write_text(page)
    (tmp_path / "b.html").write_text('<p id="here">text</p>')
    (tmp_path / "a.css").write_text("@font-face { src: url('https://example.org/font') }")
    faults = runpy.run_path(str(WEBSITE / "html_checks.py"))["faults"]
    assert faults(tmp_path) == [
        "a.html loads https://example.org/x.js",
        "a.html leads to b.html#gone, which is not there",
        "a.html leads to c.html, which is not there",
        "a.css loads from the network",
    ]


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.skipif(bool(MISSING), reason=f"not installed: {', '.join(MISSING)} (`make docs` installs them)")
def test_the_site_is_built_without_a_warning_or_a_dead_link(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, WEBSITE / "build.py", "--out", tmp_path], capture_output=True, check=False, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert Path(done.stdout.splitlines()[-1]).is_file()
