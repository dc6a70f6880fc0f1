"""Exported grasps beside their recordings, hand by hand: `python -m benchmarks.physics.consistency`.

Each hand closes on each object in a run; its grasps are written as Parquet, read again by a reader that
shares nothing with qdgrasp, and the closed hand is put where the file says, as convex bodies of its own
(`tests.tools.export.collision_bodies`). Lengths are mm. Depths are compared with the recorded ones,
which Bullet took before its last step: of the bodies as they are, and of those grown by Bullet's margin.
A contact is a point on the object: where bodies are inside each other it may be off the link by their depth.
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
from tests.common import own_endpoint
from tests.tools.export.collision_bodies import MARGIN, Bodies
from tests.tools.export.independent_readers import READERS, closed_hands

import qdgrasp

HANDS = ("panda", "robotiq_2f", "allegro", "barrett", "shadow", "ref_bh280", "ref_robotiq_2f")
OBJECTS = ("rubiks_cube", "mug", "bowl")
DEEPER, APART = 3e-4, 1e-3  # m
NAMES = (
    "hand", "object", "grasps", "moved, median / p90", "deeper than recorded, median / max",
    f"at most {1e3 * DEEPER:g} deeper", "grown: off the recorded depth, median / p99 / max",
    "contacts", "contact off the object, median", "grown: contact off the object / its link, max",
    f"at most {1e3 * APART:g} off both", f"off the link at most {1e3 * APART:g} more than the depth",
    "commanded pose: off the recorded depth, median / max",
)  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser("python -m benchmarks.physics.consistency", description=__doc__)
    parser.add_argument("--hands", nargs="+", default=HANDS, metavar="HAND")
    parser.add_argument("--objects", nargs="+", default=OBJECTS, metavar="OBJECT")
    parser.add_argument("--protocol", default="paper")
    parser.add_argument("--evaluations", type=int, default=600, metavar="N")
    parser.add_argument("--grasps", type=int, default=200, metavar="N", help="of each run, at most")
    parser.add_argument("--workers", type=int, default=1, metavar="N")
    asked = parser.parse_args()
    sys.stdout.write(line(NAMES) + line(["---"] * len(NAMES)))
    for hand, body in product(asked.hands, asked.objects):
        with tempfile.TemporaryDirectory() as folder:
            run = Path(folder, "run")
            flags = {
                "gripper": hand, "object": body, "protocol": asked.protocol, "out": run,
                "evaluations": asked.evaluations, "workers": asked.workers, "listen": own_endpoint(),
            }  # fmt: skip
            command("run", *(word for name, value in flags.items() for word in (f"--{name}", value)))
            if len(qdgrasp.open(run).grasps(min_fitness=1)):
                sys.stdout.write(line([hand, body, *figures(run, asked.grasps)]))
            else:
                sys.stdout.write(line([hand, body, "0", *["" for _ in NAMES[3:]]]))
            sys.stdout.flush()
    return 0


def command(*words: object) -> None:
    line = [sys.executable, "-m", "qdgrasp", *map(str, words)]
    subprocess.run(line, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def line(cells: Iterator[str] | tuple[str, ...] | list[str]) -> str:
    return f"| {' | '.join(cells)} |\n"


def figures(run: Path, most: int) -> Iterator[str]:
    """Compare the grasps of a run with its file of them, a cell of the table each."""
    out = run / "grasps.parquet"
    command("export", run, "--format", "parquet", "--min-fitness", 1, "--diverse", most, "-o", out)
    read = READERS["parquet"](out)
    hands, scene = closed_hands("parquet", read), run / "scene.bundle"
    plain, grown = Bodies(scene), Bodies(scene, MARGIN)
    bare, simulated, commanded, contacts = [], [], [], []
    for place, joints in enumerate(hands.joints):
        here = grown.hand(hands.poses[place], joints)
        before = grown.hand(read.matrices[place], joints)
        at = plain.hand(hands.poses[place], joints)
        bare.append(plain.depth(at))
        simulated.append(grown.depth(here))
        commanded.append(grown.depth(before))
        told, depth = hands.contacts[place], hands.penetration[place]
        pairs = zip(plain.apart(at, told), grown.apart(here, told), strict=True)
        contacts += [(first, *both, both[1] - depth) for (first, _), both in pairs]
    deeper = np.array(bare) - hands.penetration
    off, before_off = (np.abs(np.array(each) - hands.penetration) for each in (simulated, commanded))
    bare_off, from_object, from_link, beyond = np.array(contacts).T
    yield str(len(deeper))
    yield quantiles(1e-3 * read.beside["motion_mm"].to_numpy(), 50, 90)
    yield quantiles(deeper, 50, 100)
    yield f"{(deeper <= DEEPER).mean():.1%}"
    yield quantiles(off, 50, 99, 100)
    yield str(len(contacts))
    yield quantiles(bare_off, 50)
    yield f"{quantiles(from_object, 100)} / {quantiles(from_link, 100)}"
    yield f"{(np.maximum(from_object, from_link) <= APART).mean():.2%}"
    yield f"{(beyond <= APART).mean():.2%}"
    yield quantiles(before_off, 50, 100)


def quantiles(lengths: np.ndarray, *percents: float) -> str:
    return " / ".join(f"{1e3 * value:.2f}" for value in np.percentile(lengths, percents))


if __name__ == "__main__":
    sys.exit(main())
