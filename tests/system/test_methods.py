"""A run of the method that keeps most in mind, with the prior that looks farthest."""

import pytest
from tests.system.commands import SMALL

OPTIONS = (*SMALL, "--method", "antipodal_cma_mae")


@pytest.mark.slow
def test_a_run_that_is_extended_is_the_longer_run(qdgrasp):
    for out, budget, workers in (("long", 150, 2), ("short", 70, 1)):
        done = qdgrasp("run", *OPTIONS, "--evaluations", budget, "--workers", workers, "--out", out)
        assert done.code == 0, done.err
    assert qdgrasp.digest("short") != qdgrasp.digest("long")
    done = qdgrasp("resume", "short", "--evaluations", 150, "--workers", 1)
    assert done.code == 0, done.err
    assert qdgrasp.digest("short") == qdgrasp.digest("long")
    info = qdgrasp.info("long")
    assert (info["method"], info["evaluations"], info["errors"]) == ("antipodal_cma_mae", 150, 0)
    assert info["successes"] > 0
