"""Prometheus' query language and alert rules, as far as deploy/ needs them."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from operator import add, eq, ge, gt, le, lt, mul, ne, sub, truediv
from typing import Any

Labels = frozenset[tuple[str, str]]
Vector = dict[Labels, float]
Samples = list[tuple[float, float]]
"""Times [s] and values, in order."""

STALE = 300.0  # seconds after which a series that ended has no value
COMPARISONS = {"==": eq, "!=": ne, ">": gt, "<": lt, ">=": ge, "<=": le}
ARITHMETIC = {"+": add, "-": sub, "*": mul, "/": truediv}
MATCHES: dict[str, Callable[[str, str], bool]] = {
    "=": eq,
    "!=": ne,
    "=~": lambda value, pattern: re.fullmatch(pattern, value) is not None,
    "!~": lambda value, pattern: re.fullmatch(pattern, value) is None,
}


@dataclass
class Data:
    """Series, as they were up to some time."""

    series: dict[tuple[str, Labels], Samples] = field(default_factory=dict)

    def of(self, selector: "Selector") -> Iterable[tuple[Labels, Samples]]:
        for (name, labels), samples in self.series.items():
            known = dict(labels)
            if name == selector.name and all(
                MATCHES[how](known.get(label, ""), wanted) for label, how, wanted in selector.matchers
            ):
                yield labels, samples


class Expression:
    """Something that has a value at a time: a number, or one for each of some labels."""

    def at(self, data: Data, now: float) -> Vector | float:
        raise NotImplementedError


@dataclass(frozen=True)
class Number(Expression):
    value: float

    def at(self, data: Data, now: float) -> float:
        return self.value


@dataclass(frozen=True)
class Selector(Expression):
    name: str
    matchers: tuple[tuple[str, str, str], ...] = ()
    window: float | None = None

    def at(self, data: Data, now: float) -> Vector:
        found = {labels: [v for t, v in part if now - STALE < t <= now] for labels, part in data.of(self)}
        return {labels: values[-1] for labels, values in found.items() if values}

    def lately(self, data: Data, now: float) -> dict[Labels, Samples]:
        assert self.window is not None
        begun = now - self.window
        return {labels: [one for one in part if begun < one[0] <= now] for labels, part in data.of(self)}


@dataclass(frozen=True)
class OverTime(Expression):
    """A function of what a series was lately."""

    act: Callable[[Samples, float, float], float | None]
    selector: Selector

    def at(self, data: Data, now: float) -> Vector:
        assert self.selector.window is not None
        lately = self.selector.lately(data, now).items()
        found = {labels: self.act(part, now, self.selector.window) for labels, part in lately if part}
        return {labels: value for labels, value in found.items() if value is not None}


@dataclass(frozen=True)
class Each(Expression):
    """A function of each value."""

    act: Callable[..., float]
    inner: Expression
    rest: tuple[Expression, ...] = ()

    def at(self, data: Data, now: float) -> Vector:
        rest = [one.at(data, now) for one in self.rest]
        return {labels: self.act(value, *rest) for labels, value in vector(self.inner.at(data, now)).items()}


@dataclass(frozen=True)
class Aggregation(Expression):
    act: Callable[[list[float]], float]
    by: tuple[str, ...]
    inner: Expression

    def at(self, data: Data, now: float) -> Vector:
        groups: dict[Labels, list[float]] = {}
        for labels, value in vector(self.inner.at(data, now)).items():
            groups.setdefault(only(labels, self.by), []).append(value)
        return {labels: self.act(values) for labels, values in groups.items()}


@dataclass(frozen=True)
class Foremost(Expression):
    """The greatest, or the least, of some."""

    most: int
    is_least: bool
    inner: Expression

    def at(self, data: Data, now: float) -> Vector:
        found = sorted(vector(self.inner.at(data, now)).items(), key=lambda one: one[1])
        return dict(found[: self.most] if self.is_least else found[-self.most :])


@dataclass(frozen=True)
class Operation(Expression):
    """Two sides and what stands between them; `on`: the labels that are to be the same, None: all."""

    sign: str
    on: tuple[str, ...] | None
    left: Expression
    right: Expression

    def at(self, data: Data, now: float) -> Vector | float:
        left, right = self.left.at(data, now), self.right.at(data, now)
        if self.sign in ("and", "unless"):
            there = {self._key(labels) for labels in vector(right)}
            is_kept = self.sign == "and"
            return {one: v for one, v in vector(left).items() if (self._key(one) in there) is is_kept}
        if isinstance(left, float) and isinstance(right, float):
            return float(ARITHMETIC[self.sign](left, right))
        return self._met(left, right)

    def _met(self, left: Vector | float, right: Vector | float) -> Vector:
        whole = left if isinstance(left, dict) else vector(right)
        others = (
            {self._key(labels): value for labels, value in right.items()} if isinstance(right, dict) else {}
        )
        found: Vector = {}
        for labels in whole:
            one = left[labels] if isinstance(left, dict) else left
            other = right if isinstance(right, float) else others.get(self._key(labels))
            if other is None:
                continue
            if self.sign in ARITHMETIC:
                is_none = (self.sign, other) == ("/", 0)
                found[labels] = float("nan") if is_none else ARITHMETIC[self.sign](one, other)
            elif COMPARISONS[self.sign](one, other):
                found[labels] = one
        return found

    def _key(self, labels: Labels) -> Labels:
        return labels if self.on is None else only(labels, self.on)


def vector(value: Vector | float) -> Vector:
    assert isinstance(value, dict), f"{value} has no labels"
    return value


def only(labels: Labels, names: Iterable[str]) -> Labels:
    return frozenset((name, value) for name, value in labels if name in names)


def increase(samples: Samples, now: float, window: float) -> float | None:
    """What a counter grew by, extended to the ends of the window, but not below zero."""
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


def rate(samples: Samples, now: float, window: float) -> float | None:
    grown = increase(samples, now, window)
    return None if grown is None else grown / window


def changes(samples: Samples, now: float, window: float) -> float:
    return float(sum(before != after for (_, before), (_, after) in pairwise(samples)))


def delta(samples: Samples, now: float, window: float) -> float | None:
    return samples[-1][1] - samples[0][1] if len(samples) > 1 else None


OVER_TIME: dict[str, Callable[[Samples, float, float], float | None]] = {
    "increase": increase,
    "rate": rate,
    "changes": changes,
    "delta": delta,
    "deriv": lambda part, now, window: None if len(part) < 2 else (delta(part, now, window) or 0.0) / window,
    "max_over_time": lambda part, now, window: max(value for _, value in part),
}
EACH: dict[str, Callable[..., float]] = {"clamp_min": max}
AGGREGATIONS: dict[str, Callable[[list[float]], float]] = {
    "sum": sum,
    "max": max,
    "count": lambda values: float(len(values)),
}
FOREMOST = {"topk": False, "bottomk": True}


UNITS = {"s": 1, "m": 60, "h": 3600, "d": 86_400}
TOKEN = re.compile(
    r"\s*(?:(?P<number>\d+(?:\.\d+)?)|(?P<name>[a-zA-Z_:][a-zA-Z0-9_:]*)|(?P<text>\"(?:[^\"\\]|\\.)*\")"
    r"|(?P<sign>==|!=|>=|<=|=~|!~|[-+*/(){}\[\],<>=]))"
)
DURATION = re.compile(r"\s*(\d+)([smhd])\]")
LOOSEST_FIRST = ((*("and", "unless"),), tuple(COMPARISONS), ("+", "-"), ("*", "/"))


class Reader:
    """Reads a question, token by token."""

    def __init__(self, text: str) -> None:
        self._text, self._place = text, 0

    def whole(self) -> Expression:
        found = self._binary(0)
        if self._peek():
            raise ValueError(f"{self._text!r} goes on with {self._text[self._place :]!r}")
        return found

    def _peek(self) -> str:
        found = TOKEN.match(self._text, self._place)
        if found is None and self._text[self._place :].strip():
            raise ValueError(f"{self._text[self._place :]!r} cannot be read")
        return found[found.lastgroup or 0] if found else ""

    def _take(self, *expected: str) -> str:
        token, found = self._peek(), TOKEN.match(self._text, self._place)
        if not found or (expected and token not in expected):
            raise ValueError(f"expected one of {expected} at {self._text[self._place :]!r}")
        self._place = found.end()
        return token

    def _binary(self, level: int) -> Expression:
        if level == len(LOOSEST_FIRST):
            return self._primary()
        left = self._binary(level + 1)
        while (sign := self._peek()) in LOOSEST_FIRST[level]:
            self._take()
            on = self._names("on")
            left = Operation(sign, on, instant(left), instant(self._binary(level + 1)))
        return left

    def _names(self, word: str) -> tuple[str, ...] | None:
        """The labels behind `by` or `on`; None where that word is not there."""
        if self._peek() != word:
            return None
        self._take(word)
        self._take("(")
        names = [self._take()]
        while self._take(",", ")") == ",":
            names.append(self._take())
        return tuple(names)

    def _primary(self) -> Expression:
        first = self._take()
        if first[:1] == "(":
            inner = self._binary(0)
            self._take(")")
            return inner
        if first[:1].isdigit():
            return Number(float(first))
        if first in AGGREGATIONS or first in FOREMOST:
            return self._aggregation(first)
        return self._call(first) if self._peek() == "(" else self._selector(first)

    def _aggregation(self, name: str) -> Expression:
        by = self._names("by")
        arguments = self._arguments()
        by = by or self._names("by") or ()
        if name in FOREMOST:
            most, inner = arguments
            assert isinstance(most, Number)
            return Foremost(int(most.value), FOREMOST[name], instant(inner))
        (inner,) = arguments
        return Aggregation(AGGREGATIONS[name], by, instant(inner))

    def _call(self, name: str) -> Expression:
        arguments = self._arguments()
        if name in OVER_TIME:
            (inner,) = arguments
            if not (isinstance(inner, Selector) and inner.window):
                raise ValueError(f"{name} wants to know over which time, such as [5m]: {self._text!r}")
            return OverTime(OVER_TIME[name], inner)
        if name not in EACH:
            raise ValueError(f"there is no function {name!r} here")
        return Each(EACH[name], instant(arguments[0]), tuple(arguments[1:]))

    def _arguments(self) -> list[Expression]:
        self._take("(")
        found = [self._binary(0)]
        while self._take(",", ")") == ",":
            found.append(self._binary(0))
        return found

    def _selector(self, name: str) -> Selector:
        if not re.fullmatch(r"[a-zA-Z_:]\w*", name):
            raise ValueError(f"{name!r} is no metric")
        matchers = []
        if self._peek() == "{":
            self._take()
            while self._peek() != "}":
                label, how, value = self._take(), self._take(*MATCHES), self._take()
                re.compile(value[1:-1])
                matchers.append((label, how, value[1:-1]))
                if self._peek() != "}":
                    self._take(",")
            self._take("}")
        return Selector(name, tuple(matchers), self._window())

    def _window(self) -> float | None:
        if self._peek() != "[":
            return None
        self._take("[")
        found = DURATION.match(self._text, self._place)
        if found is None:
            raise ValueError(f"{self._text[self._place :]!r} begins with no time")
        self._place = found.end()
        return float(found[1]) * UNITS[found[2]]


def instant(inner: Expression) -> Expression:
    """The same, where it has one value at a time."""
    if isinstance(inner, Selector) and inner.window:
        raise ValueError(f"{inner.name} has many values: what of them?")
    return inner


def read(text: str) -> Expression:
    """A question to Prometheus.

    Raises
    ------
    ValueError
        It is none, or more than is understood here.
    """
    return instant(Reader(text).whole())


TEMPLATE = re.compile(r"\{\{\s*(\$labels\.(\w+)|\$value)(?:\s*\|\s*(\w+))?\s*\}\}")
PIECE = re.compile(r"(\d+)(?:\+(\d+))?(?:x(\d+))?")
WORDS = {"": lambda value: f"{value:.6g}", "humanizePercentage": lambda value: f"{100 * value:.4g}%"}


@dataclass(frozen=True)
class Alert:
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
    return Data(known)


def firing(rule: Mapping[str, Any], series: Data, until: float, step: float) -> list[Alert]:
    """The alerts of a rule that fire at a time, where it is looked at in such steps from the beginning."""
    expression, since = read(rule["expr"]), dict[Labels, float]()
    found: dict[Labels, float] = {}
    for number in range(int(until / step) + 1):
        now = number * step
        found = vector(expression.at(series, now))
        since = {labels: since.get(labels, now) for labels in found}
    return [
        Alert(labels | {*rule["labels"].items()}, told(rule["annotations"], labels, value))
        for labels, value in found.items()
        if until - since[labels] >= seconds(rule["for"])
    ]


def told(annotations: Mapping[str, str], labels: Labels, value: float) -> tuple[tuple[str, str], ...]:
    """What an alert says."""
    known = dict(labels)

    def filled(found: re.Match[str]) -> str:
        return known.get(found[2], "") if found[2] else WORDS[found[3] or ""](value)

    return tuple(sorted((name, TEMPLATE.sub(filled, words)) for name, words in annotations.items()))
