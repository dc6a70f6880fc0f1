"""Draws: the random numbers of a search, keyed so that one spec gives one stream of genomes."""

import hashlib

import numpy as np


def draws(seed: int, purpose: str, generation: int) -> np.random.Generator:
    """The generator of one purpose in one generation of one run.

    Draw whole arrays over the index from it: what a genome gets then depends on (seed, purpose, generation,
    index) alone, never on what was drawn for another purpose or generation before.

    Parameters
    ----------
    seed
        The run's seed, 0 or greater.
    purpose
        What is drawn: "initial", "parents", "mutation" ...
    generation
        0 .. 2**32 - 1.
    """
    digest = hashlib.sha256(purpose.encode()).digest()
    words = tuple(int.from_bytes(digest[i : i + 4], "little") for i in (0, 4, 8, 12))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(*words, generation)))
