"""Batches as a coordinator leases them."""

import numpy as np

from qdgrasp_protocol.messages import Work

GENES = 2


def work(
    batch: int = 1, epoch: int = 1, join: int = 1, n: int = 1, scene: str = "0" * 64, **deeds: int
) -> Work:
    """A batch of n rows whose genomes hold their place, and the simulator's deed: `row_3=ABORT`."""
    genomes = np.zeros((n, GENES), dtype="<f4")
    genomes[:, 0] = np.arange(n)
    for row, deed in deeds.items():
        genomes[int(row.removeprefix("row_")), 1] = deed
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
