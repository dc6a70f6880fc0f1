"""Batches as a coordinator leases them."""

import numpy as np

from qdgrasp_protocol.messages import Work

GENES = 2


def work(batch: int = 1, epoch: int = 1, join: int = 1, n: int = 1, scene: str = "0" * 64) -> Work:
    """A batch of n rows whose genomes hold their place."""
    genomes = np.repeat(np.arange(n, dtype="<f4")[:, None], GENES, axis=1)
    columns = {
        "index": np.arange(n, dtype="<u4").tobytes(),
        "trial": bytes(2 * n),
        "genome": genomes.tobytes(),
    }
    return Work(
        epoch=epoch,
        run="run",
        scene=scene,
        prior="contact",
        generation=0,
        batch=bytes([batch]) * 16,
        attempt=1,
        join=join,
        n=n,
        genes=GENES,
        columns=columns,
    )
