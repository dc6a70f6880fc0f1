"""The Markdown pages of the repository as pages of the site, with their pictures and the files they link to.

Pages keep their text. Only targets of links change: `docs/` is the root of the site, files outside it
are shown on pages under `files/`, and files within it are copied.
"""

import re
import tomllib
from dataclasses import dataclass, field
from os.path import normpath, relpath
from pathlib import Path

Pages = dict[str, str | Path]
"""Parts of the site by path: the text of a page, or the file that is copied."""

LINK = re.compile(r"(?<=\]\()(?![a-z]+:|#)([^)\s#]+)(#[^)\s]*)?(?=\))")
PICTURE = re.compile(r"!\[([^\]]*)\]\(([^)\s]+)\)")
TITLE = re.compile(r"^# (.+)$", re.MULTILINE)
PAGE_INDEXES = ("index.md", "README.md")
SKIPPED_FOLDERS = {"__pycache__"}
MOST_SHOWN = 100_000
"""Bytes of a file that is shown on a page; larger ones are copied."""
LEXERS = {
    ".json": "json",
    ".json5": "javascript",
    ".py": "python",
    ".sbatch": "bash",
    ".sh": "bash",
    ".toml": "toml",
    ".yaml": "yaml",
    ".yml": "yaml",
    ".service": "ini",
}


@dataclass(frozen=True)
class Section:
    """One part of the sidebar."""

    title: str
    pages: list[str]
    """Paths in the repository; patterns are not resolved."""
    generated: list[str] = field(default_factory=list)
    """Paths in the site of pages that are made at build time."""
    titles: dict[str, str] = field(default_factory=dict)
    """Words of the sidebar, by page; a page that is not there stands with its own title."""


def navigation(root: Path) -> list[Section]:
    """Return the parts of the sidebar, in their order."""
    text = (root / "docs/website/navigation.toml").read_text(encoding="utf-8")
    return [Section(**section) for section in tomllib.loads(text)["section"]]


def pages(root: Path) -> Pages:
    """Return all pages that come from Markdown files of the repository, and all files they need."""
    return Site(root).lay_out()


class Site:
    """The pages of a site while they are laid out."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._sections = navigation(root)
        self._pages: Pages = {}

    def lay_out(self) -> Pages:
        """Return every page and file of the site by its path there."""
        self._add_page("docs/index.md", self._sidebar())
        for section in self._sections:
            for name in section.pages:
                if "*" in name:
                    self._add_folder(name)
                else:
                    self._add_page(name)
        self._pages["gallery.md"] = self._gallery()
        return self._pages

    def _add_page(self, name: str, ending: str = "") -> None:
        text = (self._root / name).read_text(encoding="utf-8")
        at = page_path(name)
        self._pages[at] = LINK.sub(lambda link: self._link(name, link), text) + ending

    def _add_folder(self, pattern: str) -> None:
        """Add the pages of a folder, below its index or below one that is made of their titles."""
        folder = str(Path(pattern).parent)
        names = sorted(str(path.relative_to(self._root)) for path in self._root.glob(pattern))
        index = next((name for name in names if Path(name).name in PAGE_INDEXES), None)
        below = [name for name in names if name != index]
        for name in below:
            self._add_page(name)
        listed = toctree([Path(name).name for name in below], hidden=index is not None)
        if index is None:
            title = Path(folder).name.replace("-", " ").capitalize()
            self._pages[page_path(f"{folder}/index.md")] = f"# {title}\n{listed}"
        else:
            self._add_page(index, listed)

    def _sidebar(self) -> str:
        return "".join(
            toctree([self._entry(name, section) for name in section.pages] + section.generated, section.title)
            for section in self._sections
        )

    def _entry(self, name: str, section: Section) -> str:
        at = self._index_of(name)
        return f"{section.titles[name]} <{at}>" if name in section.titles else at

    def _index_of(self, name: str) -> str:
        """Return the page that an entry of the sidebar leads to; for a pattern the index of its folder."""
        if "*" not in name:
            return page_path(name)
        folder = Path(name).parent
        found = next((n for n in PAGE_INDEXES if (self._root / folder / n).is_file()), PAGE_INDEXES[0])
        return page_path(str(folder / found))

    def _link(self, page: str, link: re.Match[str]) -> str:
        target = normpath(Path(page).parent / link[1])
        to = self._target(target)
        return relpath(to, Path(page_path(page)).parent) + (link[2] or "")

    def _target(self, target: str) -> str:
        """Return the path in the site that a link to a path in the repository leads to, and have it there."""
        path = self._root / target
        if path.suffix == ".md" or not path.exists():
            return page_path(target)  # Sphinx reports a page that is missing
        if path.is_dir():
            return self._folder_target(target)
        if target.startswith("docs/"):
            self._pages[page_path(target)] = path
            return page_path(target)
        return self._show_file(target)

    def _folder_target(self, target: str) -> str:
        for section in self._sections:
            for name in section.pages:
                if "*" in name and str(Path(name).parent) == target:
                    return self._index_of(name)
        at = f"files/{target}/index.md"
        if at not in self._pages:
            self._pages[at] = ""  # a folder is listed once, also where its files link back
            files = sorted(path for path in (self._root / target).rglob("*") if path.is_file())
            kept = [path for path in files if not SKIPPED_FOLDERS & set(path.parts)]
            names = [str(path.relative_to(self._root)) for path in kept]
            items = "\n".join(
                f"- [{relpath(name, target)}]({relpath(self._show_file(name), f'files/{target}')})"
                for name in names
            )
            self._pages[at] = f"---\norphan: true\n---\n\n# {target}\n\n{items}\n"
        return at

    def _show_file(self, name: str) -> str:
        """Add a page that shows a file, or a copy of the file where it is no text or too long."""
        path = self._root / name
        copy = f"files/{name}"
        self._pages[copy] = path
        if path.stat().st_size > MOST_SHOWN or not is_text(path):
            return copy
        at = f"{copy}.page.md"
        lexer = LEXERS.get(path.suffix, "text")
        shown = f"```{{literalinclude}} {path.name}\n:language: {lexer}\n```"
        self._pages[at] = f"---\norphan: true\n---\n\n# {name}\n\n{{download}}`{path.name}`\n\n{shown}\n"
        return at

    def _gallery(self) -> str:
        """Return a page with each picture of the pages once, under the title of the page that has it."""
        seen: set[str] = set()
        parts = ["# Gallery\n\nThe pictures of the pages, each with a link to the page that explains it.\n"]
        names = [name for section in self._sections for name in section.pages if name.startswith("docs/")]
        for name in names:
            if "*" in name:
                continue
            text = (self._root / name).read_text(encoding="utf-8")
            figures = []
            for alt, target in PICTURE.findall(text):
                picture = self._target(normpath(Path(name).parent / target))
                if picture not in seen:
                    seen.add(picture)
                    words = alt or Path(picture).stem.replace("-", ", ")
                    target = page_path(name).removesuffix(".md") + ".html"
                    figures.append(
                        f":::{{figure}} {picture}\n:alt: {words}\n:target: {target}\n\n{words}\n:::"
                    )
            if figures:
                title = found[1] if (found := TITLE.search(text)) else Path(name).stem
                grid = "\n\n".join(["::::{container} gallery", *figures, "::::"])
                parts.append(f"## {title}\n\nFrom [{title}]({page_path(name)}).\n\n{grid}\n")
        return "\n".join(parts)


def page_path(name: str) -> str:
    """Return the path in the site of a page or file of the repository."""
    return name.removeprefix("docs/")


def toctree(names: list[str], caption: str = "", *, hidden: bool = True) -> str:
    """Return a table of contents in MyST, which Sphinx makes the sidebar of."""
    options = (
        ":maxdepth: 1\n" + (":hidden:\n" if hidden else "") + (f":caption: {caption}\n" if caption else "")
    )
    return f"\n```{{toctree}}\n{options}\n" + "\n".join(names) + "\n```\n"


def is_text(path: Path) -> bool:
    """Return whether a file holds UTF-8."""
    try:
        path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        return False
    return True
