"""Signatures: pictures say in their file what drew them, so that none of anybody else's is replaced."""

from pathlib import Path

SIGNATURE = {"Software": "qdgrasp"}
"""What `savefig` writes beside the pixels of a PNG file."""
HEAD = 4096
"""Bytes of a file that are looked at."""


def is_signed(path: Path) -> bool:
    """Whether a file is a PNG that was drawn here."""
    with path.open("rb") as file:
        head = file.read(HEAD)
    return head.startswith(b"\x89PNG") and b"tEXtSoftware\0qdgrasp" in head
