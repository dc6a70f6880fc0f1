"""The platform that a worker's results come from."""

from dataclasses import replace

import numpy as np

from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker import platform as module
from qdgrasp_worker.evaluation_protocols import MIXTURE, PROTOCOLS, ROBUST
from qdgrasp_worker.evaluator import Evaluator
from qdgrasp_worker.platform import (
    PROBES,
    code_digest,
    evaluation_digest,
    platform,
    probe_digest,
    probe_scene,
    probes,
)


def test_the_platform_names_versions_and_digests_in_words():
    found = platform()
    assert {"qdgrasp", "pybullet", "numpy", "code", "probes"} <= found.keys()
    assert all(isinstance(value, str) and value for value in found.values())
    assert len(found["code"]) == len(found["probes"]) == 64


def test_the_probes_give_the_same_digest_every_time():
    assert probe_digest() == probe_digest()


def test_the_probes_reach_every_phase_of_an_evaluation():
    with Evaluator(probe_scene()) as evaluator:
        rows = evaluator.evaluate("approach", probes(), np.zeros(PROBES, np.uint16)).rows
    outcomes = [Outcome(value) for value in rows["outcome"]]
    assert Outcome.OVERLAP in outcomes
    assert Outcome.BRUSHED in outcomes
    assert sum(outcome.is_grasp for outcome in outcomes) >= 3


def test_a_probe_that_fares_otherwise_changes_the_digest(monkeypatch):
    digest, moved = probe_digest(), probes()
    moved[0, 6] += 0.01
    monkeypatch.setattr(module, "probes", lambda: moved)
    assert probe_digest() != digest


def test_trials_that_are_drawn_otherwise_change_the_digest(monkeypatch):
    digest, drawn_otherwise = probe_digest(), replace(MIXTURE, seed=1)
    monkeypatch.setitem(PROTOCOLS, "robust", replace(ROBUST, mixture=drawn_otherwise))
    assert probe_digest() != digest


def test_code_that_gives_the_same_bits_is_named_by_the_first_that_did(monkeypatch):
    monkeypatch.setattr(module, "FIRST_RECORDED_AS", {})
    now = code_digest()
    assert now == evaluation_digest()
    monkeypatch.setattr(module, "FIRST_RECORDED_AS", {now: "ab" * 32})
    assert code_digest() == platform()["code"] == "ab" * 32
