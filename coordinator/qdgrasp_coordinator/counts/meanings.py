"""Meanings: the descriptions of fields (`Meta(description=...)`), for whoever shows what is in them."""

from functools import cache
from typing import get_type_hints

from msgspec import Meta, Struct


@cache
def meanings(kind: type[Struct]) -> dict[str, str]:
    """The description of each field of a struct that has one, those of its bases too."""
    hints = get_type_hints(kind, include_extras=True)
    return {
        field: meta.description
        for field, hint in hints.items()
        for meta in getattr(hint, "__metadata__", ())
        if isinstance(meta, Meta) and meta.description
    }
