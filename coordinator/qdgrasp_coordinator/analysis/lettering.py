"""Lettering: words of others as a figure can show them."""

from functools import cache

from matplotlib.font_manager import FontProperties, findfont, get_font

BOX = "\u25a1"
"""Stands for a letter that the font lacks."""


def lettered(words: str) -> str:
    """Words with a box for each letter that the font of figures lacks, and dollars that begin no formula."""
    letters = (letter if letter in "\n" or _is_known(letter) else BOX for letter in words)
    return "".join(letters).replace("$", r"\$")


@cache
def _is_known(letter: str) -> bool:
    """Whether the font has a letter, plain and bold."""
    files = {findfont(FontProperties(weight=weight)) for weight in ("normal", "bold")}
    return all(get_font(file).get_char_index(ord(letter)) for file in files)
