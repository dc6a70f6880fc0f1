"""A make-believe object for searches: a box whose grasps are a formula.

A hand looks at the box with its approach axis; it succeeds where its fingers reach over the surface, with
little lean and rolled along an edge, and overlaps where they reach over it otherwise. Noise that the pose
itself decides makes one of two like poses fail. Rows come back with what a worker would tell: the position
with the features of the prior `valued` behind it.
"""

from dataclasses import dataclass

import numpy as np

from qdgrasp_assets.genes import MOST_CANDIDATES, RANKING_GENES, STEEPEST_VALUE, VALUE_FEATURES, VALUED
from qdgrasp_assets.geometry.rotation import conjugate, dot, from_frame, multiply, tangents, turned, unit
from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.search.base import SearchSpace
from qdgrasp_protocol.rows import Gene, Layout, Outcome, Rows, RowShape
from qdgrasp_worker.candidate_ranking import scores, thresholds

SIZE = np.array([0.04, 0.06, 0.1])
PALM, DEEPEST = 0.06, 0.05
"""From the base to the palm, and from the palm to the fingertips [m]."""
AXIS = np.array([1.0, 0.0, 0.0])
LOOSE = 0.007
TURN = 0.15


@dataclass(frozen=True)
class Poses:
    positions: np.ndarray
    contacts: np.ndarray
    normals: np.ndarray
    rolls: np.ndarray

    def __getitem__(self, chosen) -> "Poses":
        return Poses(*(column[chosen] for column in vars(self).values()))

    @property
    def away(self) -> np.ndarray:
        return self.positions - self.contacts

    @property
    def distances(self) -> np.ndarray:
        return np.sqrt(dot(self.away, self.away))

    @property
    def facing(self) -> np.ndarray:
        """Cosine of nu."""
        return np.clip(dot(self.away, self.normals) / np.maximum(self.distances, 1e-9), -1, 1)

    @property
    def asides(self) -> np.ndarray:
        return turned(*tangents(-self.away / self.distances[..., None]), self.rolls)[0]

    @property
    def quaternions(self) -> np.ndarray:
        directions = -self.away / self.distances[..., None]
        at_rest = from_frame(*tangents(AXIS[None]), AXIS[None])
        frames = from_frame(*turned(*tangents(directions), self.rolls), directions)
        return multiply(frames, conjugate(np.broadcast_to(at_rest, frames.shape)))

    @property
    def depths(self) -> np.ndarray:
        """Reach of the fingers over the surface, 0 to 1; outside of that no pose."""
        return 1 - (self.distances - PALM) / DEEPEST

    @property
    def skews(self) -> np.ndarray:
        """Misalignment of the fingers along the box, 0 and up."""
        along = np.abs(self.asides).max(axis=-1)
        return np.arccos(np.clip(along, -1, 1)) / 0.8 + np.arccos(self.facing) / 1.2

    @property
    def is_there(self) -> np.ndarray:
        return (self.depths >= 0) & (self.depths <= 1)

    @property
    def overlaps(self) -> np.ndarray:
        clear = (np.abs(self.positions) > SIZE / 2 + 0.03).any(axis=-1)
        return ~clear | ((self.depths > 0.2) & (self.skews > 0.6))

    @property
    def outcomes(self) -> np.ndarray:
        noise = np.modf(np.abs(self.positions).sum(axis=-1) * 1e6)[0]
        good = (self.depths > 0.2) & (self.skews + 0.5 * noise < 0.75)
        held = np.where(self.skews < 0.2, Outcome.HELD, Outcome.DROPPED)
        found = np.where(good, held, Outcome.MISSED)
        return np.where(self.is_there, np.where(self.overlaps, Outcome.OVERLAP, found), Outcome.DEAD_END)

    @property
    def features(self) -> np.ndarray:
        """The features (n, f) of the prior; those that this scene has no formula for are zero."""
        swept = np.clip(self.depths - 0.2 * self.skews, 0, 1)
        known = {"swept": swept, "opposed": swept, "facing": self.facing, "distance": 1 - self.depths}
        known |= {"squareness": 1 - self.skews, "constant": np.ones_like(swept)}
        return np.stack([known.get(name, np.zeros_like(swept)) for name in VALUE_FEATURES], axis=-1)


def space(prior: str, posture: tuple[str, ...] = ()) -> SearchSpace:
    """The space of genomes of `prior`, "valued" or "contact"."""
    reach = PALM + DEEPEST
    box = (-SIZE / 2 - reach, SIZE / 2 + reach)
    own = _aimed(box) if prior == VALUED else _contact()
    layout = Layout(prior, own + tuple(Gene(name, 0.0, 1.0) for name in posture))
    return SearchSpace(layout, box, tuple(AXIS), (PALM, reach))


def shape(where: SearchSpace) -> RowShape:
    return RowShape(len(where.layout), 1, 3 + len(VALUE_FEATURES))


def evaluate(where: SearchSpace, generation: int, genomes: np.ndarray) -> Rows:
    """Rows that are a function of the genomes alone."""
    rows = shape(where).empty(len(genomes))
    rows["generation"], rows["index"], rows["genome"] = generation, np.arange(len(genomes)), genomes
    values, is_aimed = where.layout.values(genomes), where.layout.prior == VALUED
    poses, proposals = _candidates(genomes, values) if is_aimed else (_cone(values), 1)
    rows["outcome"] = np.where(np.less(proposals, 0), Outcome.DEAD_END, poses.outcomes)
    rows["proposals"] = np.abs(proposals)
    rows["fitness"] = np.maximum(rows["outcome"].astype(float) - Outcome.DROPPED, 0)
    rows["descriptor"] = np.concatenate([poses.positions, poses.features], axis=1)
    rows["base_to_object"] = np.concatenate([poses.positions, poses.quaternions], axis=1)
    rows["surface_point"] = poses.contacts
    return rows


def play(
    search, where: SearchSpace, evaluations: int, overlaps: str = "redraw", rows_at_most: int = 10**6
) -> Rows:
    """The rows of a search's generations until so many evaluations are counted."""
    told: list[Rows] = []
    counted = rows = 0
    while counted < evaluations and rows < rows_at_most:
        told.append(evaluate(where, len(told), search.ask(len(told))))
        search.tell(len(told) - 1, told[-1])
        least = Outcome.MISSED if overlaps == "redraw" else Outcome.ERROR
        counted += int((told[-1]["outcome"] >= least).sum())
        rows += len(told[-1])
    return np.concatenate(told)


def covered(rows: Rows, least: Outcome = Outcome.DROPPED) -> int:
    """Number of cells that hold a success, or such an outcome at least."""
    return len(np.unique(cells(rows[rows["outcome"] >= least]["descriptor"][:, :3]), axis=0))


def nearest(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The points of the box's surface nearest to `points` (..., 3), with their normals."""
    inside = np.clip(points, -SIZE / 2, SIZE / 2)
    depth = SIZE / 2 - np.abs(inside)
    axis = depth.argmin(axis=-1)[..., None]
    side = np.where(np.take_along_axis(inside, axis, -1) < 0, -1.0, 1.0)
    normals = np.zeros_like(inside)
    np.put_along_axis(normals, axis, side, -1)
    on = inside.copy()
    np.put_along_axis(on, axis, side * (SIZE / 2)[axis], -1)
    return on, normals


def _aimed(box) -> tuple[Gene, ...]:
    return (
        *(Gene(name, *ends) for name, *ends in zip("xyz", *box, strict=True)),
        *(Gene(name, -size / 2, size / 2) for name, size in zip("xyz", SIZE, strict=True)),
        Gene("omega", 0.0, 2 * np.pi),
        Gene("looseness", 0.0, 1.0),
        Gene("candidates", 1.0, MOST_CANDIDATES),
        *(Gene(f"weight {i}", -STEEPEST_VALUE, STEEPEST_VALUE) for i in range(RANKING_GENES - 1)),
        Gene("wanted", 0.0, 1.0),
    )


def _contact() -> tuple[Gene, ...]:
    finder = (Gene(name, -size / 2, size / 2) for name, size in zip("xyz", SIZE, strict=True))
    turns = (Gene(name, 0.0, 2 * np.pi) for name in ("xi", "omega"))
    return (*finder, Gene("nu", 0.0, np.pi), Gene("d", 0.0, DEEPEST), *turns)


def _cone(values: np.ndarray) -> Poses:
    nu, d, xi, omega = values[:, 3:7].T
    contacts, normals = nearest(values[:, :3])
    aside, _ = turned(*tangents(normals), xi)
    outward = np.cos(nu)[:, None] * normals + np.sin(nu)[:, None] * aside
    return Poses(contacts + (PALM + d)[:, None] * outward, contacts, normals, omega)


def _candidates(genomes: np.ndarray, values: np.ndarray) -> tuple[Poses, np.ndarray]:
    """The best candidate of each genome, and how many it had; less than 0: none was worth it."""
    counts = np.rint(values[:, 8]).astype(int)
    owners = np.repeat(np.arange(len(genomes)), counts)
    draws = np.concatenate([_draws(*pair) for pair in zip(genomes, counts, strict=True)])
    each, scatter = values[owners], (counts > 1)[owners, None]
    positions = np.where(scatter, cells(each[:, :3]) / 100 + 0.01 * (draws[:, :3] - 0.5), each[:, :3])
    hints = each[:, 3:6] + scatter * 3 * LOOSE * (draws[:, 3:6] - 0.5)
    is_loose = draws[:, 6] < each[:, 7]
    anywhere = SIZE * (draws[:, 7:10] - 0.5)
    contacts, normals = nearest(np.where(is_loose[:, None], anywhere, hints))
    aside, _ = turned(*tangents(unit(each[:, 3:6] - each[:, :3])), each[:, 6])
    first, second = tangents(unit(contacts - positions))
    kept = np.arctan2(dot(aside, second), dot(aside, first)) + scatter[:, 0] * TURN * (draws[:, 10] - 0.5)
    poses = Poses(positions, contacts, normals, np.where(is_loose, 2 * np.pi * draws[:, 11], kept))
    weights = values[:, 9 : 9 + RANKING_GENES]
    values_of, least = scores(poses.features, weights[owners]), thresholds(weights)
    takes_any = least == -np.inf
    is_good = (poses.outcomes >= Outcome.MISSED) & (values_of >= least[owners])
    preference = 2 * is_good + (poses.is_there & takes_any[owners])
    order = np.lexsort((-values_of, -preference, owners))
    best = order[np.unique(owners[order], return_index=True)[1]]
    return poses[best], np.where(is_good[best] | takes_any, counts, -counts)


def _draws(genome: np.ndarray, n: int) -> np.ndarray:
    """Numbers (n, 12) from 0 to 1 that depend on the genome alone."""
    return np.random.default_rng(np.frombuffer(genome.tobytes(), np.uint32)).random((n, 12))


BOX = (np.full(3, -0.2), np.full(3, 0.2))


def plain(genes: int) -> SearchSpace:
    """A space of genes that stand for themselves, around a box of 40 cm."""
    return SearchSpace(Layout("contact", tuple(Gene(f"gene {i}", -1.0, 1.0) for i in range(genes))), BOX)
