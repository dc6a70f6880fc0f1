"""TOML that may come from a stranger, read with limits.

The standard library's reader recurses into lists, takes numbers of any length, and remembers every
beginning of a dotted key: 200 KB of `a.a.a` take all memory there is.
"""

import re
import tomllib
from typing import Any

from qdgrasp_protocol.errors import InputError

MAX_SIZE = 4 << 20
"""The most characters that are looked at; 4096 poses of a hand with 25 joints are two million."""
MAX_DOTS = 64
"""The most dots between two separators of a line."""
SEPARATORS = re.compile(r"[,={\[]")


def loads(text: str, where: str) -> dict[str, Any]:
    """The values in a TOML text.

    Raises
    ------
    InputError
        The text is not TOML, or longer or deeper than a spec can be.
    """
    if len(text) > MAX_SIZE:
        raise InputError(f"{where} has {len(text)} characters, and none may have more than {MAX_SIZE}.")
    if any(_dots(line) > MAX_DOTS for line in text.splitlines()):
        raise InputError(f"{where} has a key of more than {MAX_DOTS} parts.")
    try:
        return tomllib.loads(text)
    except ValueError as error:
        raise InputError(f"{where} is not TOML: {error}.") from None
    except RecursionError:
        raise InputError(f"{where} has lists in lists in lists without end.") from None


def _dots(line: str) -> int:
    """The most dots in what may be one key."""
    return max(part.count(".") for part in SEPARATORS.split(line)) if line.count(".") > MAX_DOTS else 0
