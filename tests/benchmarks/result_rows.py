"""Rows of the table of results, made by hand."""

from typing import Any

from benchmarks.results.table import Row

TODAY, BEFORE = "c0de" * 4, "01dc0de0" * 2


def row(method: str = "aimed", seed: int = 0, **values: Any) -> Row:
    """A finished run of 1000 evaluations."""
    said: dict[str, Any] = {
        "gripper": "panda", "object": "ycb_mug", "protocol": "paper", "overlaps": "count", "settings": "",
        "budget": 1000, "version": "0.1.0", "code": TODAY, "platform": "aa", "scene": "bb", "journal": "cc",
        "evaluations": 1000, "simulated": 500, "proposals": 1000, "successes": 100, "grasps": 80,
        "robust": 60, "cells": 90, "cpu_seconds": 10.0,
    }  # fmt: skip
    return Row(**{**said, "method": method, "seed": seed, **values})
