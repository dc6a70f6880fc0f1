"""Runs whose processes are killed end as undisturbed ones do: `python -m tests.chaos`.

Without --seed: one seed of 20 000 evaluations and nine of 5000, some of them at a time, each in a process of
its own: most of the time they wait for a process to be started again, or to go on.
"""

import argparse
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.chaos.plan import bad_workers, faults, run_kind
from tests.chaos.play import disturb, undisturbed_digest

LONG, SHORT = 20_000, 5_000
SEEDS = range(10)
"""The first is the long one."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Disturb the runs that are asked for; 1 where one did not end as it should."""
    parser = argparse.ArgumentParser(prog="python -m tests.chaos", description=__doc__)
    parser.add_argument("--seed", type=int, help="only this one")
    parser.add_argument("--evaluations", type=int, help="in a run (default: 20000 of seed 0, 5000 of others)")
    parser.add_argument("--workers", type=int, default=4, help="how many (default: 4)")
    parser.add_argument("--bad", type=int, default=2, help="kinds of bad workers besides (default: 2)")
    parser.add_argument("--together", type=int, default=3, help="seeds at a time (default: 3)")
    parser.add_argument("--minutes", type=float, default=30.0, help="that one run may take (default: 30)")
    parser.add_argument("--out", type=Path, default=Path("runs/chaos"), help="folder (default: runs/chaos)")
    asked = parser.parse_args(arguments)
    if asked.seed is not None:
        return int(not carry_out(asked.seed, asked))
    began = time.monotonic()
    failed = carry_out_all(list(sys.argv[1:] if arguments is None else arguments), asked.together)
    say(f"{len(SEEDS)} seeds in {(time.monotonic() - began) / 60:.1f} min; failed: {failed or 'none'}")
    return int(bool(failed))


def carry_out_all(arguments: list[str], together: int) -> list[int]:
    """Carry all seeds out, so many at a time; those that failed."""

    def is_well(seed: int) -> bool:
        command = [sys.executable, "-m", "tests.chaos", *arguments, "--seed", str(seed)]
        return subprocess.run(command, check=False).returncode == 0

    longest_first = sorted(SEEDS, key=lambda seed: run_kind(seed).protocol != "robust")
    with ThreadPoolExecutor(together) as pool:
        fared = zip(longest_first, pool.map(is_well, longest_first), strict=True)
        return sorted(seed for seed, well in fared if not well)


def carry_out(seed: int, asked: argparse.Namespace) -> bool:
    """Carry the run of a seed out, undisturbed and disturbed; whether both gave the same."""
    evaluations = asked.evaluations or (LONG if seed == SEEDS[0] else SHORT)
    kind = run_kind(seed)
    spec = kind.spec(seed, evaluations)
    out = asked.out.resolve()
    say(f"seed {seed}: {evaluations} evaluations, {kind.method}, protocol {kind.protocol}")
    home = out / f"seed-{seed}"
    expected = undisturbed_digest(spec, out / f"undisturbed-{seed}")
    say(f"seed {seed}: undisturbed digest {expected}")
    shutil.rmtree(home, ignore_errors=True)
    plan = faults(seed, asked.workers)
    terms = {
        "workers": asked.workers,
        "row_seconds": kind.row_seconds,
        "limit": 60 * asked.minutes,
        "bad": bad_workers(seed, asked.bad),
    }
    report = disturb(home, spec, plan, **terms, say=lambda line: say(f"{seed}: {line}"))
    is_same = report.digest == expected
    verdict = "the same" if is_same else "that of a part" if report.is_given_up else "ANOTHER ONE"
    say(f"seed {seed}: {report.words}; ended by themselves: {dict(report.ended) or 'none'}")
    say(f"seed {seed}: disturbed digest {report.digest or 'none'}: {verdict}")
    if is_same and not report.troubles:
        return True
    say(f"seed {seed} FAILED: {'; '.join(report.troubles) or 'the digests differ'}; everything is in {home}")
    say(f"again: python -m tests.chaos --seed {seed} --evaluations {evaluations} --workers {asked.workers}")
    return False


def say(line: str) -> None:
    """Print a line now."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
