"""Figures in a few characters."""

UNITS = ("B", "kB", "MB", "GB", "TB")


def count(number: float) -> str:
    """A count with its thousands apart: 41 200."""
    return f"{round(number):,}".replace(",", " ")


def short(number: float) -> str:
    """A count in at most five characters: 950, 41.2k, 1.2M."""
    for unit, size in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if number >= size * 9.995:
            scaled = number / size
            return f"{scaled:.1f}{unit}" if scaled < 99.95 else f"{scaled:.0f}{unit}"
    return f"{number:.0f}" if number >= 10 or number == int(number) else f"{number:.1f}"


def part(some: float, total: float) -> str:
    """A share in per cent, in at most five characters: 0 %, <1 %, 62 %."""
    share = 100 * some / total if total else 0.0
    return "<1 %" if 0 < share < 0.5 else f"{share:.0f} %"


def span(seconds: float) -> str:
    """A time in at most seven characters: 4 s, 12:05, 3:12 h, 2.5 d."""
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02d}"
    return f"{whole // 3600}:{whole // 60 % 60:02d} h" if whole < 86_400 else f"{whole / 86_400:.1f} d"


def size(number: float) -> str:
    """Bytes in at most six characters: 310 MB."""
    unit = 0
    while number >= 999.5 and unit < len(UNITS) - 1:
        number, unit = number / 1000, unit + 1
    return f"{number:.1f} {UNITS[unit]}" if unit and number < 9.95 else f"{number:.0f} {UNITS[unit]}"
