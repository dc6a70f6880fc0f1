"""The golden files, and the functions that make them anew."""

from collections.abc import Callable
from difflib import unified_diff
from pathlib import Path

from tests.golden import formats, interfaces, runs, wire

FILES = Path(__file__).parent / "files"
DIGESTS = "digests.toml"
"""The golden file of one platform alone (docs/reproducibility.md)."""
MAKERS: dict[str, Callable[[], str]] = {
    "messages.toml": wire.message_text,
    "shown.txt": wire.shown_text,
    "keys.txt": wire.key_text,
    "metrics.txt": formats.metric_text,
    "journal.sql": formats.journal_text,
    "versions.txt": formats.version_text,
    "names.txt": interfaces.name_text,
    "exit_codes.txt": interfaces.exit_code_text,
    DIGESTS: runs.digest_text,
}


def differences(name: str, now: str) -> str:
    """Differences from the golden file, line by line; empty: none. A missing file is empty."""
    path = FILES / name
    kept = path.read_text(encoding="utf-8") if path.exists() else ""
    lines = [text.splitlines(keepends=True) for text in (kept, now)]
    return "".join(unified_diff(*lines, f"files/{name}", "now", n=1))
