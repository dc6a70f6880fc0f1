"""The documentation site has every page once, and can be built."""

import runpy
import subprocess
import sys
import tomllib
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

import pytest
from tests.docs.pages import ROOT

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
