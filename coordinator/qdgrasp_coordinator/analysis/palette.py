"""Palette: how methods look, in every figure alike. A prior is a hue, a family of searches a line style.

The hues are those of Okabe and Ito, told apart with any colour vision.
"""

from matplotlib.colors import to_hex, to_rgb

from qdgrasp_coordinator.search import METHODS, PRIORS

Dashes = str | tuple[int, tuple[float, ...]]
INK, FAINT, RULE, CONTEXT = "#22262b", "#69717a", "#d9dde1", "#c9ced3"
"""Text, text beside it, rules, and curves that only give context."""
HUES = {"contact": "#0072b2", "approach": "#d55e00", "antipodal": "#009e73", "spherical": "#4d4d4d"}
WORDS = {"spherical": "no prior"}
"""What a prior is called in a figure, where not by its name."""
FAMILIES: dict[str, Dashes] = {
    "me_scs": "-",
    "cma_mae": (0, (1.1, 1.3)),
    "me_rand": (0, (5, 1.6, 1.1, 1.6)),
    "rand": (0, (4.2, 2.2)),
}
"""Line styles: the searches are drawn through, dotted or dash-dotted, plain sampling is dashed."""
ORDER = ("contact", "approach", "antipodal", "spherical")


def prior_of(method: str) -> str:
    """The prior of a method."""
    return METHODS[method].prior


def family_of(method: str) -> str:
    """The family of a method: its name without the prior's prefix."""
    return method.removeprefix(PRIORS[prior_of(method)].prefix)


def hue_of(method: str, variant: int = 0) -> str:
    """The colour of a method; of the variants of one, each is paler than the one before."""
    share = min(0.75, 0.22 * variant)
    red, green, blue = (part + (1 - part) * share for part in to_rgb(HUES[prior_of(method)]))
    return to_hex((red, green, blue))


def dashes_of(method: str) -> Dashes:
    """The line style of a method."""
    return FAMILIES[family_of(method)]


def words_of(prior: str) -> str:
    """What a prior is called."""
    return WORDS.get(prior, prior)
