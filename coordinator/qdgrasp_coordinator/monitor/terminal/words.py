"""Figures in a few characters."""

LONGEST = 99_999 * 86_400.0  # seconds; nobody waits for longer
SIZES = ("", "k", "M", "G", "T")
UNITS = ("B", "kB", "MB", "GB", "TB")


def count(number: float) -> str:
    """A count with its thousands apart: 41 200."""
    return f"{round(number):,}".replace(",", " ")


def short(number: float) -> str:
    """A count in at most five characters: 0.8, 950, 41.2k, 1.2M."""
    if number < 9_999.5:
        return f"{number:.0f}" if number >= 10 or number == int(number) else f"{number:.1f}"
    unit = 0
    while number >= 999.5 and unit < len(SIZES) - 1:
        number, unit = number / 1000, unit + 1
    return f"{number:.1f}{SIZES[unit]}" if number < 99.95 else f"{number:.0f}{SIZES[unit]}"


def part(some: float, total: float) -> str:
    """A share in per cent, in at most five characters: 0 %, <1 %, 62 %."""
    share = 100 * some / total if total else 0.0
    return "<1 %" if 0 < share <= 0.5 else f"{share:.0f} %"


def span(seconds: float) -> str:
    """A time in at most seven characters: 4 s, 12:05, 3:12 h, 2.5 d."""
    whole = max(0, round(min(seconds, LONGEST)))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02d}"
    if whole < 86_400:
        return f"{whole // 3600}:{whole // 60 % 60:02d} h"
    days = whole / 86_400
    return f"{days:.1f} d" if days < 99.95 else f"{days:.0f} d"


def size(number: float) -> str:
    """Bytes in at most six characters: 310 MB."""
    unit = 0
    while number >= 999.5 and unit < len(UNITS) - 1:
        number, unit = number / 1000, unit + 1
    return f"{number:.1f} {UNITS[unit]}" if unit and number < 9.95 else f"{number:.0f} {UNITS[unit]}"
