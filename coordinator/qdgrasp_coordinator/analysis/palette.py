"""Palette: how methods look, in every figure alike. A prior is a hue, a family of searches a line style.

The hues are those of Okabe and Ito, told apart with any colour vision.
"""

from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple

from matplotlib.colors import to_hex, to_rgb

from qdgrasp_coordinator.searches.search import METHODS, PRIORS

Dashes = Literal["-"] | tuple[float, Sequence[float]]
INK, FAINT, RULE, CONTEXT = "#22262b", "#69717a", "#d9dde1", "#c9ced3"
"""Text, text beside it, rules, and curves that only give context."""
HUES = {
    "contact": "#0072b2",
    "approach": "#d55e00",
    "antipodal": "#009e73",
    "aimed": "#cc79a7",
    "spherical": "#4d4d4d",
}
WORDS = {"spherical": "no prior"}
"""What a prior is called in a figure, where not by its name."""
FAMILIES: dict[str, Dashes] = {
    "aimed": "-",
    "me_scs": "-",
    "cma_mae": (0, (1.1, 1.3)),
    "me_rand": (0, (5, 1.6, 1.1, 1.6)),
    "rand": (0, (4.2, 2.2)),
}
"""Line styles: the searches are drawn through, dotted or dash-dotted, plain sampling is dashed."""
PALEST = 0.65
"""How much white is in the palest of a method's variants."""
ORDER = ("aimed", "contact", "approach", "antipodal", "spherical")
"""The priors as they stand in legends and side by side: the default method's leads."""


Arm = tuple[str, str]
"""A method, and the words that tell its variant from others."""


class Look(NamedTuple):
    """How an arm is drawn."""

    colour: str
    dashes: Dashes


def prior_of(method: str) -> str:
    """The prior of a method."""
    return METHODS[method].prior


def family_of(method: str) -> str:
    """The family of a method: its name without the prior's prefix."""
    return method.removeprefix(PRIORS[prior_of(method)].prefix)


def looks(arms: Iterable[Arm]) -> dict[Arm, Look]:
    """The look of each arm; of the variants of one method, each is paler than the one before."""
    variants: dict[str, list[Arm]] = {}
    for arm in dict.fromkeys(arms):
        variants.setdefault(arm[0], []).append(arm)
    return {
        arm: Look(hue_of(method, place / max(1, len(same) - 1)), FAMILIES[family_of(method)])
        for method, same in variants.items()
        for place, arm in enumerate(same)
    }


def hue_of(method: str, pale: float = 0.0) -> str:
    """The colour of a method, from its full hue at 0 to the palest of its variants at 1."""
    red, green, blue = (part + (1 - part) * PALEST * pale for part in to_rgb(HUES[prior_of(method)]))
    return to_hex((red, green, blue))


def words_of(prior: str) -> str:
    """What a prior is called."""
    return WORDS.get(prior, prior)
