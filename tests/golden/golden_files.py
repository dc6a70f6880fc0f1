"""What stays as it is: golden files, and what makes them anew."""

from collections.abc import Callable
from difflib import unified_diff
from pathlib import Path

from tests.golden import formats, interfaces, recorded, runs, wire

FILES = Path(__file__).parent / "files"
DIGESTS = "digests.toml"
"""That of a platform alone (docs/reproducibility.md)."""
MAKERS: dict[str, Callable[[], str]] = {
    "messages.toml": wire.message_text,
    "shown.txt": wire.shown_text,
    "keys.txt": wire.key_text,
    "metrics.txt": formats.metric_text,
    "journal.sql": formats.journal_text,
    "versions.txt": formats.version_text,
    "help.txt": interfaces.help_text,
    "names.txt": interfaces.name_text,
    "exit_codes.txt": interfaces.exit_code_text,
    "exported.csv": recorded.csv_text,
    "exported.yaml": recorded.isaac_text,
    DIGESTS: runs.digest_text,
}


def kept(name: str) -> str:
    """What a golden file says; nothing where there is none yet."""
    path = FILES / name
    return path.read_text(encoding="utf-8") if path.exists() else ""


def differences(name: str, now: str) -> str:
    """How it is now, beside what the golden file says, line by line; empty: the same."""
    lines = [text.splitlines(keepends=True) for text in (kept(name), now)]
    return "".join(unified_diff(*lines, f"files/{name}", "now", n=1))
