"""HTML for notebooks: a picture within the text beside a table of figures, without scripts."""

import io
from base64 import b64encode
from collections.abc import Iterable, Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Figure = tuple[str, object]
"""The name of a figure and its value, or words."""
COLOURS = 128  # Of a picture: it stays below 100 kB, and looks the same
CARD = "display:flex;flex-wrap:wrap;gap:16px;align-items:flex-start"
PICTURE = "background:#fff;border-radius:6px;max-width:100%"
CELL = "text-align:left;padding:2px 12px 2px 0;vertical-align:top"


def inline_png(picture: NDArray[np.uint8] | Image.Image) -> str:
    """Return a picture as an address that holds all of it, in few colours."""
    image = picture if isinstance(picture, Image.Image) else Image.fromarray(picture)
    file = io.BytesIO()
    image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(file, format="PNG", optimize=True)
    return f"data:image/png;base64,{b64encode(file.getvalue()).decode()}"


def picture_html(picture: NDArray[np.uint8] | Image.Image, words: str) -> str:
    """Return a picture with the words that stand for it where it is not seen."""
    return f'<img src="{inline_png(picture)}" alt="{escape(words)}" style="{PICTURE}">'


def card(title: str, picture: NDArray[np.uint8] | Image.Image | None, figures: Iterable[Figure]) -> str:
    """Return a picture beside a title and a table of figures; everything said is escaped."""
    shown = "" if picture is None else f"<div>{picture_html(picture, title)}</div>"
    lines = "".join(
        f'<tr><th style="{CELL}">{escape(name)}</th><td style="{CELL}">{escape(str(value))}</td></tr>'
        for name, value in figures
    )
    return f'<div style="{CARD}">{shown}<div><b>{escape(title)}</b><table>{lines}</table></div></div>'


def table(head: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Return a table of cells that are HTML already; it scrolls where it is wider than the page."""
    heads = "".join(f'<th style="{CELL}">{escape(word)}</th>' for word in head)
    rows = ("".join(f'<td style="{CELL}">{cell}</td>' for cell in line) for line in lines)
    body = "".join(f"<tr>{row}</tr>" for row in (heads, *rows))
    return f'<div style="overflow-x:auto"><table>{body}</table></div>'
