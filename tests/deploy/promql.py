"""What questions to Prometheus mean, as far as rules and dashboard need it; `promql_reader` reads them.

After the public description, "Querying Prometheus": operators and functions mean what they mean there; a
counter's increase reaches to the ends of its window as Prometheus extends it.
"""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from operator import add, eq, ge, gt, le, lt, mul, ne, sub, truediv

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
