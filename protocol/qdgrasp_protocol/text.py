"""Text for people: names and numbers in sentences, and text of others made safe to print."""

from collections.abc import Callable, Iterable, Sequence


def printable(text: str, most: int | None = None) -> str:
    r"""The text on one line, at most `most` characters, with escapes for unprintable ones."""
    shown = "".join(one if one.isprintable() else ascii(one)[1:-1] for one in text)
    return shown[:most]


def printable_lines(text: str) -> str:
    """The text with escapes for unprintable characters, on the lines that it has."""
    return "\n".join(map(printable, text.split("\n")))


def counted(n: int, thing: str, things: str = "", told: Callable[[int], str] = str) -> str:
    """Return a number with its noun: "1 run", "2 runs"; `told` formats the number."""
    return f"{told(n)} {thing if n == 1 else things or f'{thing}s'}"


def first_few(words: Sequence[str], most: int) -> str:
    """Return the first words, and the number of the others: "a, b and 3 more"."""
    more = f" and {len(words) - most} more" if len(words) > most else ""
    return ", ".join(words[:most]) + more


def quoted(names: Iterable[str]) -> list[str]:
    """Quote names from users: "'a'"."""
    return [f"'{name}'" for name in names]


def join_numbers(values: Iterable[float]) -> str:
    """Format numbers, such as those of an axis: "0, 0, 1"."""
    return ", ".join(f"{value:g}" for value in values)


def parse_numbers(text: str) -> list[float]:
    """Parse typed numbers between commas; empty where there is anything else."""
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        return []


def rough_time(seconds: float) -> str:
    """Return a time in words, no finer than an estimate is: 40 s, 12 min, 3 h 10 min, 5 days."""
    hours, tens = divmod(round(seconds / 600), 6)
    if seconds < 90:
        return f"{5 * max(1, round(seconds / 5))} s"
    if not hours:
        return f"{round(seconds / 60)} min"
    if hours < 10:
        return f"{hours} h {10 * tens} min" if tens else f"{hours} h"
    return f"{round(seconds / 3600)} h" if hours < 72 else f"{round(seconds / 86_400)} days"


def aligned_text(lines: Sequence[Sequence[str]], left: Iterable[int] = ()) -> str:
    """Return lines of cells in columns for a terminal, right-aligned but for those in `left`."""
    widths, lefts = [max(map(len, column)) for column in zip(*lines, strict=True)], set(left)
    return "\n".join(
        "  ".join(
            cell.ljust(width) if place in lefts else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


MAX_SECONDS = 99_999 * 86_400.0  # seconds; longer times are shown as this


def count_text(number: float) -> str:
    """Return a count with its thousands apart: 41 200."""
    return f"{round(number):,}".replace(",", " ")


def rate_text(number: float) -> str:
    """Return a number a second, with a tenth where it is small."""
    return f"{number:.1f}" if number < 10 and number % 1 else count_text(number)


def percent_text(some: float, total: float) -> str:
    """Return a share in per cent, in at most five characters: 0 %, <1 %, 62 %."""
    share = 100 * some / total if total else 0.0
    return "<1 %" if 0 < share <= 0.5 else f"{share:.0f} %"


def span_text(seconds: float) -> str:
    """Return a time in at most seven characters: 4 s, 12:05, 3:12 h, 2.5 d."""
    whole = max(0, round(min(seconds, MAX_SECONDS)))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02d}"
    if whole < 86_400:
        return f"{whole // 3600}:{whole // 60 % 60:02d} h"
    return f"{whole / 86_400:.1f} d"
