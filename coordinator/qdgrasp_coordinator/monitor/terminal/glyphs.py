"""The characters that pictures are made of: blocks and braille, or ASCII where there is nothing else."""

import os
from dataclasses import dataclass

from rich.console import Console

from qdgrasp_protocol.printable import printable


@dataclass(frozen=True)
class Glyphs:
    """Characters for bars, rules and curves."""

    full: str
    """Done."""
    empty: str
    """To be done."""
    rule: str
    between: str
    """Between two things in a line."""
    chosen: str
    """Before what is chosen."""
    more: str
    """Where words are cut off."""
    stages: str
    """What the parts of a bar are filled with, one after the other."""
    has_braille: bool

    def text(self, words: str) -> str:
        """What others wrote, as it may stand on the terminal."""
        shown = printable(words)
        return shown if self.has_braille else shown.encode("ascii", "backslashreplace").decode()


UNICODE = Glyphs("█", "░", "─", " · ", "▸", "…", "·░▒▓▚█", has_braille=True)
ASCII = Glyphs("#", ".", "-", " | ", ">", "~", ".:-=+#", has_braille=False)


def glyphs_of(console: Console, *, ascii_only: bool = False) -> Glyphs:
    """Those that a terminal can show; the font of Linux's own console has no braille."""
    has_all = console.encoding.lower().startswith("utf") and os.environ.get("TERM") != "linux"
    return UNICODE if has_all and not ascii_only else ASCII
