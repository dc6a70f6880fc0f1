"""Prometheus' query language and alert rules, as far as deploy/ needs them."""

import re
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from math import nan
from operator import add, eq, ge, gt, le, lt, mul, ne, sub
from typing import Any, NamedTuple

Labels = frozenset[tuple[str, str]]
Vector = dict[Labels, float]
Samples = list[tuple[float, float]]
"""Times [s] and values, in order."""
Data = dict[tuple[str, Labels], Samples]
"""Series by name and labels, as they were up to some time."""
Question = Callable[[Data, float], Any]
"""Answers at a time with a number, a value for each labels or, of a window, samples."""

STALE = 300.0  # seconds after which a series that ended has no value
COMPARISONS = {"and": lambda *_: True, "==": eq, "!=": ne, ">": gt, "<": lt, ">=": ge, "<=": le}
ARITHMETIC = {"+": add, "-": sub, "*": mul, "/": lambda one, other: one / other if other else nan}
MATCHES: dict[str, Callable[[str, str], bool]] = {
    "=": eq,
    "!=": ne,
    "=~": lambda value, pattern: re.fullmatch(pattern, value) is not None,
    "!~": lambda value, pattern: re.fullmatch(pattern, value) is None,
}


class Selector(NamedTuple):
    """Series of a name whose labels match; with a window [s] what they were lately."""

    name: str
    matchers: tuple[tuple[str, str, str], ...]
    window: float | None

    def __call__(self, data: Data, now: float) -> dict[Labels, Any]:
        found = {}
        for (name, labels), samples in data.items():
            known = dict(labels)
            part = [one for one in samples if now - (self.window or STALE) < one[0] <= now]
            matches = (MATCHES[how](known.get(label, ""), wanted) for label, how, wanted in self.matchers)
            if name == self.name and part and all(matches):
                found[labels] = part if self.window else part[-1][1]
        return found


def increase(samples: Samples, now: float, window: float) -> float | None:
    """Growth of a counter, extended to the ends of the window, but not below zero."""
    if len(samples) < 2:
        return None
    (first, least), (last, _) = samples[0], samples[-1]
    steps = pairwise(value for _, value in samples)
    grown = sum(after - before if after >= before else after for before, after in steps)
    known, apart = last - first, (last - first) / (len(samples) - 1)
    before, after = first - (now - window), now - last
    if grown > 0:
        before = min(before, known * least / grown)
    reach = known + sum(end if end < 1.1 * apart else apart / 2 for end in (before, after))
    return grown * reach / known


def only_read(*_: Any) -> float:
    raise NotImplementedError("the dashboard asks for this, and no rule")


OVER_TIME: dict[str, Callable[[Samples, float, float], float | None]] = {
    "increase": increase,
    "max_over_time": lambda part, now, window: max(value for _, value in part),
    **dict.fromkeys(("rate", "changes", "delta", "deriv"), only_read),
}
OF_VALUES: dict[str, Callable[[list[float]], float]] = {
    "sum": sum,
    "count": len,
    **dict.fromkeys(("max", "clamp_min", "topk", "bottomk"), only_read),
}
"""Functions of the values that have the same labels."""
UNITS = {"s": 1, "m": 60, "h": 3600, "d": 86_400}
TOKEN = re.compile(
    r"\d+(?:\.\d+)?|[a-zA-Z_:][a-zA-Z0-9_:]*|\"(?:[^\"\\]|\\.)*\"|\[\d+[smhd]\]"
    r"|==|!=|>=|<=|=~|!~|[-+*/(){},<>=]"
)
LOOSEST_FIRST = (("and", "unless"), ("==", "!=", ">", "<", ">=", "<="), ("+", "-"), ("*", "/"))


class Reader:
    """Reads a question, token by token."""

    def __init__(self, text: str) -> None:
        self._text, self._left = text, deque([*TOKEN.findall(text), ""])
        if re.sub(r"\s", "", "".join(self._left)) != re.sub(r"\s", "", text):
            raise ValueError(f"{text!r} cannot be read")

    def whole(self) -> Question:
        found = self._binary(0)
        if self._left[0]:
            raise ValueError(f"{self._text!r} goes on with {[*self._left]}")
        return found

    def _take(self, *expected: str) -> str:
        token = self._left[0]
        if not token or (expected and token not in expected):
            raise ValueError(f"expected one of {expected} at {[*self._left]} of {self._text!r}")
        return self._left.popleft()

    def _list(self, item: Callable[[], Any], ends: str = "()") -> list[Any]:
        self._take(ends[0])
        found = [item()]
        while self._take(",", ends[1]) == ",":
            found.append(item())
        return found

    def _names(self, word: str) -> list[str] | None:
        """The labels behind `by` or `on`; None where that word is not there."""
        return self._list(self._take) if self._left[0] == word and self._take() else None

    def _binary(self, level: int) -> Question:
        if level == len(LOOSEST_FIRST):
            return self._primary()
        left = self._binary(level + 1)
        while self._left[0] in LOOSEST_FIRST[level]:
            sign, on = self._take(), self._names("on")
            left = operation(sign, on, instant(left), instant(self._binary(level + 1)))
        return left

    def _primary(self) -> Question:
        if self._left[0] == "(":
            (inner,) = self._list(lambda: self._binary(0))
            return inner
        first = self._take()
        if first[0].isdigit():
            return lambda data, now: float(first)
        return self._call(first) if self._left[0] in ("(", "by") else self._selector(first)

    def _call(self, name: str) -> Question:
        by, arguments = self._names("by") or [], self._list(lambda: self._binary(0))
        if name in OF_VALUES:
            return grouped(OF_VALUES[name], by, [instant(one) for one in arguments][-1])
        (selector,) = arguments
        if name not in OVER_TIME or not (isinstance(selector, Selector) and selector.window):
            raise ValueError(f"{name} is no function of a time such as [5m]: {self._text!r}")
        return over_time(OVER_TIME[name], selector, selector.window)

    def _selector(self, name: str) -> Selector:
        if not re.fullmatch(r"[a-zA-Z_:][\w:]*", name):
            raise ValueError(f"{name!r} is no metric")
        matchers = self._list(self._matcher, "{}") if self._left[0] == "{" else []
        is_window = self._left[0].startswith("[")
        return Selector(name, tuple(matchers), seconds(self._take()[1:-1]) if is_window else None)

    def _matcher(self) -> tuple[str, str, str]:
        label, how, value = self._take(), self._take(*MATCHES), self._take()[1:-1]
        re.compile(value)
        return label, how, value


def only(labels: Labels, names: Sequence[str]) -> Labels:
    return frozenset((name, value) for name, value in labels if name in names)


def operation(sign: str, on: Sequence[str] | None, left: Question, right: Question) -> Question:
    """Two sides and their operator; the labels `on` are to be the same, None: all."""

    def key(labels: Labels) -> Labels:
        return labels if on is None else only(labels, on)

    def answer(data: Data, now: float) -> Vector:
        ones, others = left(data, now), right(data, now)
        ones = dict.fromkeys(others, ones) if isinstance(ones, float) else ones
        others = dict.fromkeys(ones, others) if isinstance(others, float) else others
        keyed = {key(labels): value for labels, value in others.items()}
        if sign == "unless":
            return {labels: value for labels, value in ones.items() if key(labels) not in keyed}
        met = {labels: (value, keyed[key(labels)]) for labels, value in ones.items() if key(labels) in keyed}
        if sign in ARITHMETIC:
            return {labels: ARITHMETIC[sign](*both) for labels, both in met.items()}
        return {labels: both[0] for labels, both in met.items() if COMPARISONS[sign](*both)}

    return answer


def over_time(act: Callable[..., float | None], selector: Selector, window: float) -> Question:
    """A function of the recent samples of series."""

    def answer(data: Data, now: float) -> Vector:
        found = {labels: act(part, now, window) for labels, part in selector(data, now).items()}
        return {labels: value for labels, value in found.items() if value is not None}

    return answer


def grouped(act: Callable[[list[float]], float], by: Sequence[str], inner: Question) -> Question:
    """A function of the values whose labels `by` are the same."""

    def answer(data: Data, now: float) -> Vector:
        groups: dict[Labels, list[float]] = {}
        for labels, value in inner(data, now).items():
            groups.setdefault(only(labels, by), []).append(value)
        return {labels: act(values) for labels, values in groups.items()}

    return answer


def instant(inner: Question) -> Question:
    """The same, where it has one value at a time."""
    if isinstance(inner, Selector) and inner.window:
        raise ValueError(f"{inner.name} has many values: what of them?")
    return inner


def read(text: str) -> Question:
    """Read a question; raises ValueError for one that is not understood here."""
    return instant(Reader(text).whole())


TEMPLATE = re.compile(r"\{\{\s*(\$labels\.(\w+)|\$value)(?:\s*\|\s*(\w+))?\s*\}\}")
PIECE = re.compile(r"(\d+)(?:\+(\d+))?(?:x(\d+))?")
WORDS = {"": lambda value: f"{value:.6g}", "humanizePercentage": lambda value: f"{100 * value:.4g}%"}


class Alert(NamedTuple):
    """One that fires."""

    labels: Labels
    words: tuple[tuple[str, str], ...]


def seconds(text: str) -> float:
    """A time such as 5m [s]."""
    return float(text[:-1]) * UNITS[text[-1]]


def values(notation: str) -> Iterator[float]:
    """The values that a notation stands for: `0+10x3 7x2` are 0 10 20 30 7 7 7."""
    for piece in notation.split():
        found = PIECE.fullmatch(piece)
        assert found, piece
        first, step, more = (float(part or 0) for part in found.groups())
        yield from (first + number * step for number in range(int(more) + 1))


def data(series: Sequence[Mapping[str, str]], interval: float) -> Data:
    """The series of a test."""
    known = {}
    for one in series:
        selector = read(one["series"])
        assert isinstance(selector, Selector)
        labels = frozenset((label, value) for label, _, value in selector.matchers)
        samples = [(number * interval, value) for number, value in enumerate(values(one["values"]))]
        known[selector.name, labels] = samples
    return known


def firing(rule: Mapping[str, Any], series: Data, until: float, step: float) -> list[Alert]:
    """Return the alerts of a rule at a time, looked at in such steps from the beginning."""
    expression, since = read(rule["expr"]), dict[Labels, float]()
    found: dict[Labels, float] = {}
    for number in range(int(until / step) + 1):
        now = number * step
        found = expression(series, now)
        since = {labels: since.get(labels, now) for labels in found}
    return [
        Alert(labels | {*rule["labels"].items()}, told(rule["annotations"], labels, value))
        for labels, value in found.items()
        if until - since[labels] >= seconds(rule["for"])
    ]


def told(annotations: Mapping[str, str], labels: Labels, value: float) -> tuple[tuple[str, str], ...]:
    """Return the annotations of an alert with their variables filled in."""
    known = dict(labels)

    def filled(found: re.Match[str]) -> str:
        return known.get(found[2], "") if found[2] else WORDS[found[3] or ""](value)

    return tuple(sorted((name, TEMPLATE.sub(filled, words)) for name, words in annotations.items()))
