"""Meanings: what is written below the fields of a struct, so that what is shown is described in one place."""

import ast
import inspect
from collections.abc import Iterator
from functools import cache
from itertools import pairwise

from msgspec import Struct


@cache
def meanings(kind: type[Struct]) -> dict[str, str]:
    """What stands below each field of a struct in its source, those of its bases too, each in one line."""
    bases = [base for base in reversed(kind.__mro__) if issubclass(base, Struct) and base is not Struct]
    return {field: words for base in bases for field, words in _written(base)}


def _written(kind: type[Struct]) -> Iterator[tuple[str, str]]:
    lines = [line for each in ast.parse(inspect.getsource(kind)).body for line in getattr(each, "body", ())]
    for field, below in pairwise(lines):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(words))):
                yield name, " ".join(words.split())
