"""What stands in the blocks of a page: its command lines, and its Python."""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
SPAN = re.compile(r"`(qdgrasp[ -][^`\n]*)`")
ASSIGNMENT = re.compile(r"[A-Z_]+=")


@dataclass(frozen=True)
class Line:
    """One command line of a page."""

    page: str
    number: int
    """Of the line in the page."""
    text: str
    """Without the comment behind it; continued lines are joined."""

    def __str__(self) -> str:
        return f"{self.page}:{self.number}: {self.text}"

    @property
    def program(self) -> str:
        """What is started first."""
        return next(word for word in self.text.split() if not ASSIGNMENT.match(word))

    @property
    def is_ours(self) -> bool:
        """Whether it starts a command of this package, or a script of examples/."""
        return bool(re.match(r"qdgrasp(-\w+)?$", self.program)) or self.text.startswith("python examples/")


@dataclass(frozen=True)
class Block:
    """A block of code."""

    page: str
    language: str
    number: int
    text: str

    @property
    def lines(self) -> list[Line]:
        """Its command lines."""
        found: list[Line] = []
        begun = ""
        for number, text in enumerate(self.text.splitlines(), self.number):
            begun += bare(text)
            if begun.endswith("\\"):
                begun = begun[:-1]
            elif begun:
                found.append(Line(self.page, number, begun.strip()))
                begun = ""
        return found


def bare(text: str) -> str:
    """A line without the comment behind it."""
    quoted = re.sub(r"'[^']*'|\"[^\"]*\"", lambda found: "q" * len(found[0]), text)
    comment = re.search(r"(^|\s)#", quoted)
    return text[: comment.start()].rstrip() if comment else text.rstrip()


def blocks(page: Path, *languages: str) -> list[Block]:
    """The blocks of a page in these languages."""
    text = page.read_text(encoding="utf-8")
    name = str(page.relative_to(ROOT))
    return [
        Block(name, found[1], text.count("\n", 0, found.start(2)) + 1, found[2])
        for found in FENCE.finditer(text)
        if found[1] in languages
    ]


def spans(page: Path) -> Iterator[str]:
    """The commands that a page names in its sentences."""
    yield from SPAN.findall(FENCE.sub("", page.read_text(encoding="utf-8")))


def words(line: Line) -> list[str]:
    """The words of a line of ours, the program first, up to a pipe or a redirection."""
    found = [word for word in shlex.split(line.text) if not ASSIGNMENT.match(word)]
    end = next((i for i, word in enumerate(found) if word in {"|", ">", ">>", "&&"}), len(found))
    return found[:end]
