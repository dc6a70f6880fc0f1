"""Scores of successes over their trials, and the order of grasps from the best to the worst.

Where the evaluation protocol has trials, the score of a success is their fitness in sum, known once all of
them are recorded; elsewhere it is the nominal fitness. Over all disturbances of the trials it is eta, the
estimated probability that the grasp transfers (Huber et al. 2024, section IV: 100 trials of two shakes, so
it is the sum over 200; trials of `physical` have six forces each).
"""

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.run_stats import success_mask, successes
from qdgrasp_protocol.rows import SHAKES, Outcome, Rows

ROBUST = Outcome.HELD - Outcome.DROPPED  # Survival of what is held, and its entry in reference sets


def survival(rows: Rows) -> NDArray[np.uint8]:
    """Return for successes (n,) 0: no disturbance was survived, 1: some were, 2: all."""
    return np.asarray(rows["outcome"] - np.uint8(Outcome.DROPPED))


class TrialSums:
    """Sums up the trials of each success while the blocks of a journal pass in order.

    Each success has `trials` trials; 0: the protocol has no trials.
    """

    def __init__(self, trials: int) -> None:
        self._trials = trials
        # Successes whose trials are not complete, in journal order, with the `fitness` so far in sum
        self._waiting: Rows | None = None
        self._seen = np.zeros(0, dtype=np.int64)  # Number of trials of each of them that were added

    def take(self, rows: Rows) -> Rows:
        """The nominal successes whose score is known with these rows, in journal order: (n,).

        Their `fitness` is the score: disturbances survived, in the nominal evaluation or in all trials.
        """
        found = successes(rows)
        if not self._trials:
            return found
        found["fitness"] = 0
        waiting = found if self._waiting is None else np.concatenate([self._waiting, found])
        self._seen = np.concatenate([self._seen, np.zeros(len(found), np.int64)])
        trials = rows[rows["trial"] > 0]
        place = np.searchsorted(genome_numbers(waiting), genome_numbers(trials))
        np.add.at(waiting["fitness"], place, trials["fitness"])
        np.add.at(self._seen, place, 1)
        n = int(np.count_nonzero(self._seen == self._trials))
        self._waiting, self._seen = waiting[n:], self._seen[n:]
        return waiting[:n]


def scored_successes(blocks: Iterable[Rows], trials: int) -> Iterator[Rows]:
    """The scored successes of a journal, block by block; see `TrialSums.take`."""
    scores = TrialSums(trials)
    for block in blocks:
        yield scores.take(block)


def trial_sums(journal: Rows, trials: int) -> NDArray[np.float64]:
    """Return the score of each nominal row of a whole journal (n,); 0 for what is no success."""
    nominal = journal[journal["trial"] == 0]
    found = TrialSums(trials).take(journal)
    totals = np.zeros(len(nominal))
    totals[np.searchsorted(genome_numbers(nominal), genome_numbers(found))] = found["fitness"]
    return totals


def known_scores(rows: Rows, trials: int) -> NDArray[np.float64]:
    """Return the score of each nominal success among consecutive rows of a journal (n,).

    NaN where not all of its trials are among them. The journal may begin anywhere, or be joined of several.
    """
    found, first = np.flatnonzero(success_mask(rows)), np.flatnonzero(rows["trial"] == 1)
    first = first[first + trials <= len(rows)]
    # The trials of a success follow it in one piece. One number per row, ascending by genome and then by
    # place, finds the next first trial behind each success, which may be of another genome.
    _, genomes = np.unique(genome_numbers(rows), return_inverse=True)
    of_found, of_first = genomes[found] * len(rows) + found, genomes[first] * len(rows) + first
    order = np.argsort(of_first)
    place = np.searchsorted(of_first[order], of_found)
    scores = np.full(len(found), np.nan)
    here = np.flatnonzero(place < len(first))
    begins = first[order][place[here]]
    is_its = genome_numbers(rows)[begins] == genome_numbers(rows)[found[here]]
    total = np.concatenate([[0.0], np.cumsum(rows["fitness"], dtype=np.float64)])
    scores[here[is_its]] = (total[begins + trials] - total[begins])[is_its]
    return scores


def eta(fitness: NDArray[np.number], trials: int, disturbances: int = SHAKES) -> NDArray[np.float64]:
    """Return eta, 0 to 1, of scores (n,) over trials with so many disturbances each: (n,)."""
    return fitness.astype(np.float64) / (disturbances * trials)


def genome_numbers(rows: Rows) -> NDArray[np.uint64]:
    """One number for the genome of each row, ascending in the journal of one run: (n,)."""
    numbers: NDArray[np.uint64] = (rows["generation"].astype(np.uint64) << np.uint64(32)) | rows["index"]
    return numbers


def best_first(rows: Rows, scores: NDArray[np.floating] | None = None) -> NDArray[np.int64]:
    """The places (n,) of nominal rows, best first.

    One row is better than another with a greater score (n,); of equals with a greater fitness; of equals with
    less penetration; of equals with more contacts; of equals the earlier one in the journal. A score that is
    not known is NaN, which is worse than any.
    """
    known = np.zeros(len(rows)) if scores is None else np.nan_to_num(scores, nan=-1.0)
    elder_last, contacts = (rows["index"], rows["generation"]), rows["contacts"].astype(np.int64)
    return np.lexsort((*elder_last, -contacts, rows["penetration"], -rows["fitness"], -known))
