"""The search that aims: a try in an empty cell beside a success, with the grasp that worked next door.

What an archive tells grasps apart by, the position of the hand, is known before anything is simulated. So
the search chooses the cell first, by its frontier, and then the genes that bring the hand there: the contact
point, roll and posture of a successful neighbour. The worker makes candidates of these, screens them for
overlap, and simulates the one that a model ranks first; the model learns here, and its weights travel in the
genome.

New in this project, not from the paper. What selects is success alone; where the frontier is poor, some of
the tries go to cells whose grasp is not robust, beside robust ones.
"""

import numpy as np

from qdgrasp_assets.genes import FEATURES, MOST_CANDIDATES
from qdgrasp_assets.rotation import Floats
from qdgrasp_coordinator.searches.aims import OWN, SYNERGY, TARGET, Aims, directions, joined, scattered
from qdgrasp_coordinator.searches.draws import draws
from qdgrasp_coordinator.searches.frontier import ANYWHERE, Frontier, Places
from qdgrasp_coordinator.searches.gate import Gate
from qdgrasp_coordinator.searches.hints import Hints
from qdgrasp_coordinator.searches.ranker import Ranker
from qdgrasp_coordinator.searches.scouts import scouts
from qdgrasp_coordinator.searches.space import Space
from qdgrasp_coordinator.searches.spare import Spare
from qdgrasp_protocol.genome import Genomes, Layout
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec

START = 100
"""Genomes that scout before any is aimed."""
SCOUTS = 0.04
"""The share of evaluations that scout later, about: of genomes it is less, as nothing refuses scouts."""
LOST = 2000
"""While there is no success the scouts go astray more and more, half of them after so many genomes."""
REDRAWN = 0.15
"""The probability that a synergy is drawn anew."""
DRIFT = 0.05
"""How far free joints move from their neighbour's: standard deviation, in genes."""


class Aimed:
    """Aims at empty cells beside successes.

    Parameters
    ----------
    spec
        Where overlaps count, a genome has one candidate, so that every pose that is tried counts.
    space
        Of the prior `aimed`.
    """

    def __init__(self, spec: RunSpec, space: Space) -> None:
        self._spec = spec
        self._space = space
        self._counts_all = spec.overlaps == "count"
        self._within = space.distances if self._counts_all else ANYWHERE
        self._frontier = Frontier(space.box, space.distances[1], self._within)
        self._hints = Hints(self._frontier.size, space.approach_axis, space.genes - OWN)
        self._ranker = Ranker()
        self._gate = Gate()
        self._spare = Spare(self._frontier, self._hints)
        self._open: dict[int, Floats] = {}
        """Of generations that are not told yet, what was known of the empty cells that they aim at."""
        self._candidates = 1 if self._counts_all else MOST_CANDIDATES
        self._asked = 0

    def ask(self, generation: int) -> Genomes:
        """Aims at the best cells, and scouts: (population, genes)."""
        targets = self._targets(generation)
        self._open[generation] = self._frontier.features(targets[~self._frontier.successful[targets]])
        aimed = self._aimed(targets, generation)
        if self._candidates == 1:
            aimed = scattered(aimed, draws(self._spec.seed, "scatter", generation))
        scouts = self._scouts(generation, self._spec.population - len(aimed))
        wanted = self._gate.wanted(self._frontier.dead_ends(aimed.targets))
        weights = self._weights(np.concatenate([wanted, np.zeros(len(scouts))]))
        genomes = joined(aimed, scouts).genomes(self._space.layout, self._candidates, weights)
        self._frontier.aim(self._aimed_at(genomes))
        self._asked += len(genomes)
        return genomes

    def tell(self, generation: int, rows: Rows) -> None:
        """Hear which cells were reached, which were dead ends, and what the poses looked like."""
        is_simulated = rows["outcome"] >= Outcome.MISSED
        is_success = rows["outcome"] >= Outcome.DROPPED
        features = self._open.pop(generation)
        is_told, n = is_simulated | self._counts_all, len(features)
        fresh, again = is_told[:n], np.stack([is_told, rows["outcome"] >= Outcome.HELD], axis=1)[n:]
        self._frontier.learn(features[fresh], is_success[:n][fresh])
        self._spare.tell(generation, is_success[:n][fresh], again)
        self._frontier.fail(self._aimed_at(rows["genome"][~is_simulated]))
        self._succeed(rows[is_success])
        self._ranker.learn(rows[is_simulated])
        self._gate.tell(is_told)

    def _succeed(self, successes: Rows) -> None:
        """Hear of successes; those outside the box are passed over."""
        places = self._frontier.places(successes["descriptor"][:, :3])
        successes, places = successes[places >= 0], places[places >= 0]
        self._frontier.succeed(places, successes["surface_point"].astype(np.float64))
        self._hints.learn(places, successes)
        self._spare.succeed(places[successes["outcome"] >= Outcome.HELD])

    def _targets(self, generation: int) -> Places:
        """The cells to aim at, each once, at most as many as the population; none in the beginning."""
        if self._asked < START:
            return np.zeros(0, np.intp)
        generator = draws(self._spec.seed, "targets", generation)
        scouts = SCOUTS * self._gate.share
        n = int(np.count_nonzero(generator.random(self._spec.population) >= scouts))
        best = self._frontier.best(n, generator)
        spare = self._spare.ask(generation, generator)
        left = max(0, min(len(best), n - len(spare)))
        return np.concatenate([self._frontier.best(left, generator, best), spare])

    def _aimed(self, targets: Places, generation: int) -> Aims:
        """The grasps of neighbours, for the cells `targets`."""
        generator = draws(self._spec.seed, "parents", generation)
        parents = self._parents(targets, generator)
        centres, contacts = self._frontier.centres(targets), self._hints.points(parents)
        rolls = self._hints.rolls(parents, directions(centres, contacts))
        postures = self._varied(self._hints.postures(parents), generator)
        return Aims(centres, contacts, rolls, np.zeros(len(targets)), postures)

    def _parents(self, targets: Places, generator: np.random.Generator) -> Places:
        """For each target a success around it, or in it, as far from it as is wanted where there is one."""
        options = np.concatenate([self._frontier.around(targets), targets[:, None]], axis=1)
        preference = self._hints.preference(options, generator)
        least, greatest = self._within
        distances = self._hints.distances(options, self._frontier.centres(targets))
        is_near = (distances >= least) & (distances <= greatest)
        preference = np.where(is_near, preference, np.minimum(preference, 0.0))
        parents: Places = options[np.arange(len(targets)), preference.argmax(axis=1)]
        return parents

    def _varied(self, postures: Floats, generator: np.random.Generator) -> Floats:
        """Postures (n, k) with some synergies drawn anew and free joints moved a little."""
        names = self._space.layout.names[OWN:]
        anew = generator.uniform(-1.0, 1.0, postures.shape)
        moved = np.clip(postures + DRIFT * generator.standard_normal(postures.shape), -1.0, 1.0)
        is_anew = generator.random((len(postures), 1)) < REDRAWN
        is_synergy = np.array([name == SYNERGY for name in names], dtype=np.bool_)
        return np.where(is_synergy, np.where(is_anew, anew, postures), moved)

    def _weights(self, wanted: Floats) -> Floats:
        """What the candidates of each genome are ranked by, and what they must promise: (n, features).

        Where every pose counts, one that is refused would count as well.
        """
        if self._counts_all:
            return np.zeros((len(wanted), len(FEATURES)))
        return self._ranker.wanting(wanted)

    def _scouts(self, generation: int, n: int) -> Aims:
        found = len(self._hints) > 0
        astray = 0.0 if found else min(0.5, 0.5 * self._asked / LOST)
        loosest = 0.0 if self._candidates == 1 else 1.0
        return scouts(self._space, n, astray, loosest, draws(self._spec.seed, "scouts", generation))

    def _aimed_at(self, genomes: Genomes) -> Places:
        """The cells (n,) that genomes (n, d) aim at."""
        target = Layout(self._space.layout.prior, self._space.layout.genes[TARGET])
        return self._frontier.places(target.values(genomes[:, TARGET]))
