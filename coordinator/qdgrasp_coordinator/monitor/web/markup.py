"""Pages as HTML: files that name the parts which they have in common, each in a line of its own."""

import re
from pathlib import Path
from textwrap import indent

PAGES = Path(__file__).with_name("pages")
PART = re.compile(r"^( *)<!-- (parts/\w+\.html) -->\n", re.MULTILINE)


def html(name: str) -> str:
    """The page of that name, with its parts."""
    return PART.sub(lambda part: indent(_text(part[2]), part[1]), _text(f"{name}.html"))


def _text(name: str) -> str:
    return (PAGES / name).read_text(encoding="utf-8")
