"""First contacts of fingers that close, with each other and with the palm.

The links of one hand pass through each other in the simulator, so that fingers that close too far would hold
thin objects as no real hand can. Here a hand closes step by step, all fingers at the same share of their
way, first the whole hand and then each of its synergies. Fingers stop at their first contact.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np

from qdgrasp_assets.gripper_setup.closing_motion import CROSSED, DEEP_OVERLAP, ClosingMotion, Posture
from qdgrasp_assets.grippers.hand_model import Finger, HandModel, are_deep, with_followers
from qdgrasp_assets.scene import Synergy

STEPS = np.linspace(0.0, 1.0, 21)[1:]
"""Shares of the way at which contacts are looked for: 1 cm of a finger of 0.15 m, which is as thick."""
HALVINGS = 6  # Times that the step in which fingers meet is halved
UNITS = {True: 1e-3, False: 1e-4}
"""Unit to which stop positions of fingers are rounded: revolute joints (True) [rad], prismatic ones [m]."""


def stop_at_contact(
    closing: ClosingMotion, synergies: Iterable[Synergy], told: Iterable[str]
) -> ClosingMotion:
    """Return the motion whose fingers stop where they meet.

    Joints in `told` close as stated. Links that are in each other in the open hand are left out.
    Two fingers that turn the same way may be `CROSSED` deep in each other at their sides, all others
    `DEEP_OVERLAP`.
    """
    contacts = _Contacts(closing, frozenset(told))
    contacts.close(closing.closed)
    for synergy in synergies:
        contacts.close(synergy.joints)
    stopped = {name: reason for name, reason in contacts.reasons.items() if contacts.shares[name] < 1.0}
    closed = {name: _toward(closing, name, contacts.shares[name]) for name in closing.closed}
    return replace(closing, closed=closed, stopped=stopped)


def _toward(closing: ClosingMotion, name: str, share: float) -> float:
    """Return a joint's position at a share of its way, rounded toward the open one."""
    opened, closed = closing.opened[name], closing.closed[name]
    if share >= 1.0:
        return closed
    unit = UNITS[closing.body.joint(name).kind != "prismatic"]
    way = np.floor(abs(closed - opened) * share / unit) * unit
    return float(round(opened + np.sign(closed - opened) * way, 6))


class _Contacts:
    """Fingers that close, with the shares of their ways."""

    def __init__(self, closing: ClosingMotion, told: frozenset[str]) -> None:
        self.closing, self.body = closing, closing.body
        self.shares = dict.fromkeys(closing.closed, 1.0)
        """How far each joint that closes may go, as a share of its way."""
        self.reasons: dict[str, str] = {}
        self.told = told
        self.pairs = tuple(_pairs(closing))

    def close(self, joints: Iterable[str]) -> None:
        """Close some joints, the others open, and stop those of fingers that meet something."""
        moving = {name for name in joints if name in self.shares}
        before = 0.0
        for share in STEPS:
            placed = self.body.parts_at(self._posture(moving, share))
            for one, other, limit in self.pairs:
                if are_deep(placed[one], placed[other], limit):
                    self._stop(moving, one, other, limit, (before, share))
                    placed = self.body.parts_at(self._posture(moving, share))
            before = share

    def _posture(self, moving: Iterable[str], share: float) -> Posture:
        """Return the posture at a share of the way, or as far as each joint may go."""
        opened, closed = self.closing.opened, self.closing.closed
        ways = {name: min(share, self.shares[name]) for name in moving}
        places = {
            name: place + ways.get(name, 0.0) * (closed.get(name, place) - place)
            for name, place in opened.items()
        }
        return with_followers(self.body.robot, places)

    def _stop(self, moving: set[str], one: str, other: str, limit: float, step: tuple[float, float]) -> None:
        """Stop the fingers of two links within a step (low, high) of the way, before they meet."""
        low, high = step
        at = {name for name in moving if self.shares[name] > low and name not in self.told}
        stopping = {name for link in (one, other) for name in self._leaders(link) if name in at}
        if not stopping:
            return
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            placed = self.body.parts_at(self._posture(moving, middle), (one, other))
            low, high = (low, middle) if are_deep(placed[one], placed[other], limit) else (middle, high)
        for name in sorted(stopping):
            self.shares[name] = low
            self.reasons[name] = f"closes to where '{one}' meets '{other}', at {100 * low:.0f} % of its range"

    def _leaders(self, link: str) -> Iterator[str]:
        """Yield the joints that close the finger of a link."""
        for finger in self.closing.fingers:
            if link in finger.links:
                yield from closing_leaders(self.body, finger, self.closing.closed)


def closing_leaders(body: HandModel, finger: Finger, closed: Mapping[str, float]) -> tuple[str, ...]:
    """Return the joints of `closed` that move a finger, also those that its joints follow."""
    leaders = [body.followers[name].leader if name in body.followers else name for name in finger.joints]
    return tuple(dict.fromkeys(name for name in leaders if name in closed))


def _pairs(closing: ClosingMotion) -> Iterator[tuple[str, str, float]]:
    """Yield the pairs of links that may meet, with the allowed depth [m]."""
    body, rows = closing.body, closing.rows()
    numbers = {link: number for number, finger in enumerate(closing.fingers) for link in finger.links}
    opened = body.parts_at(closing.posture(0.0))
    for one, other in combinations(body.parts, 2):
        first, second = numbers.get(one, -1), numbers.get(other, -2)
        if first == second or (first < 0 and second < 0) or body.are_neighbours(one, other):
            continue
        limit = CROSSED if any({first, second} <= row for row in rows) else DEEP_OVERLAP
        if not are_deep(opened[one], opened[other], DEEP_OVERLAP):
            yield one, other, limit
