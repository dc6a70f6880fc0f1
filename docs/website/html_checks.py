"""Checks of the built pages: links and anchors lead somewhere, and nothing is loaded from the network."""

from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {
    ("script", "src"),
    ("link", "href"),
    ("img", "src"),
    ("source", "src"),
    ("iframe", "src"),
    ("object", "data"),
}
LINKED = {("a", "href"), ("area", "href")}
NOT_LOADED = {"canonical", "index", "search", "next", "prev", "license"}
"""Relations of a <link> that a browser does not follow by itself."""


class Page(HTMLParser):
    """The anchors of a page, and where it leads."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: set[str] = set()
        self.loads: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what a tag names, links to and loads."""
        values = {name: value for name, value in attrs if value}
        self.anchors |= {values[name] for name in ("id", "name") if name in values}
        is_relation = tag == "link" and values.get("rel") in NOT_LOADED
        for name, value in values.items():
            if (tag, name) in LINKED or ((tag, name) in LOADED and is_relation):
                self.links.add(value)
            elif (tag, name) in LOADED:
                self.loads.add(value)


def faults(html: Path) -> list[str]:
    """Return a sentence for each dead link, dead anchor and thing that is loaded from the network."""
    found = []
    for path in sorted(html.rglob("*.html")):
        page, name = parsed(path), path.relative_to(html)
        found += [f"{name} loads {to}" for to in sorted(page.loads) if urlsplit(to).netloc]
        found += [
            f"{name} leads to {to}, which is not there"
            for to in sorted(page.links | page.loads)
            if is_dead(path, to)
        ]
    for style in sorted(html.rglob("*.css")):
        text = style.read_text(encoding="utf-8").replace(" ", "").replace('"', "").replace("'", "")
        if "url(http" in text or "url(//" in text or "@importhttp" in text:
            found.append(f"{style.relative_to(html)} loads from the network")
    return found


def is_dead(page: Path, to: str) -> bool:
    """Return whether a link of a page leads to no file, or to no anchor of a page."""
    parts = urlsplit(to)
    if parts.scheme or parts.netloc:
        return False
    target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
    if not target.is_file():
        return True
    return bool(
        parts.fragment and target.suffix == ".html" and unquote(parts.fragment) not in parsed(target).anchors
    )


@cache
def parsed(path: Path) -> Page:
    """Return a page, read once."""
    return Page(path)
