"""Replay grasps of the Panda hand under contacts of others: `python -m benchmarks.elsewhere`.

Each set of grasps is exported as a bundle and lifted in plain MuJoCo, with a servo of 5000 N/m and 35 N a
finger, at the hand's own speed, while the object resists as on a table. Runs that are in OUT already
are used again.
"""

import argparse
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from qdgrasp_worker.engines.lift_replay import replay

METHODS = ("portfolio", "antipodal_rand")
DEFAULT = METHODS[0]
ETAS = ((0.0, 0.6), (0.6, 0.9), (0.9, 0.98), (0.98, 1.01))
CONTACTS = {
    "friction 0.5": (mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0, 0.5, 4),
    "defaults": (mujoco.mjtCone.mjCONE_PYRAMIDAL, 1.0, 1.0, 3),
}
"""Cone of friction, impratio, sliding friction, and condim (4: with friction about the normal)."""
Bools = NDArray[np.bool_]


def mallet(path: Path) -> None:
    """Write a turned mallet in metres: a handle 12 cm long and 24 mm thick, and a head of 6 by 6 cm."""
    profile = [(0, 0), (0.012, 0), (0.012, 0.12), (0.03, 0.12), (0.03, 0.18), (0, 0.18)]
    trimesh.creation.revolve(np.array(profile), sections=48).export(path)


def qdgrasp(*words: object) -> None:
    """Carry out a command of qdgrasp, quietly."""
    subprocess.run([sys.executable, "-m", "qdgrasp", *map(str, words)], check=True, capture_output=True)


def auc(values: NDArray[Any], survived: Bools) -> float:
    """Return the probability that a survivor has the greater value, ties as half; NaN without both kinds."""
    ups, downs = values[survived], values[~survived]
    if not len(ups) or not len(downs):
        return float("nan")
    apart = ups[:, None] - downs
    return float(((apart > 0) + 0.5 * (apart == 0)).mean())


def spread(places: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Return at most so many of these places, spread evenly."""
    return places[np.linspace(0, len(places) - 1, min(most, len(places))).round().astype(int)]


def replayed(bundle: Path, most: int, contacts: str) -> dict[str, NDArray[Any]]:
    """Lift at most so many held grasps of a bundle, and so many others; return what came of each."""
    model = mujoco.MjModel.from_xml_path(str(bundle / "scene.xml"))
    cone, impratio, friction, condim = CONTACTS[contacts]
    model.opt.cone, model.opt.impratio = cone, impratio
    model.geom_friction[:], model.geom_condim[:] = (friction, 0.005, 0.0001), condim
    grasps = dict(np.load(bundle / "grasps.npz", allow_pickle=False))
    is_held = grasps["outcome"] == "held"
    places = np.concatenate([spread(np.flatnonzero(kind), most) for kind in (is_held, ~is_held)])
    arrays = {name: grasps[name][places] for name in ("pose", "way", "opened", "closed")}
    survived = [
        replay(model, {name: each[n] for name, each in arrays.items()}, grasps["speeds"])[0]
        for n in range(len(places))
    ]
    return {"held": is_held[places], "eta": grasps["eta"][places], "survived": np.array(survived, dtype=bool)}


def share(survived: Bools) -> str:
    """The share that survived, and of how many."""
    return f"{survived.mean():.2f} ({len(survived)})" if len(survived) else "-"


def found(out: Path, thing: Sequence[object], name: str, method: str, asked: argparse.Namespace) -> Path:
    """Return the folder of a run; it is carried out if it is not there."""
    run = out / f"{name}-{method}"
    if not run.exists():
        budget = (
            asked.evaluations if method == DEFAULT else 4 * asked.evaluations
        )  # most of its poses overlap
        scene = ("--gripper", "panda", "--object", *thing, "--protocol", "physical", "--engine", "mujoco")
        search = (
            "--method",
            method,
            "--evaluations",
            budget,
            "--seed",
            asked.seed,
            "--workers",
            asked.workers,
        )
        qdgrasp("run", *scene, *search, "--out", run)
    return run


def scored(run: Path, asked: argparse.Namespace, *flags: str) -> Path:
    """Return the folder of the best grasps by eta, of six times as many; made if it is not there."""
    made = run.with_name("-".join([run.name, "eta", *(flag.removeprefix("--") for flag in flags)]))
    if not made.exists():
        trials = ("--base", "physical", "--engine", "mujoco", "--trials", asked.trials)
        choice = ("--top", asked.grasps, "--candidates", 6 * asked.grasps)
        qdgrasp("rerank", run, *trials, *choice, *flags, "--workers", asked.workers, "--out", made)
    return made


def report(run: Path, asked: argparse.Namespace) -> None:
    """Export a run's successes, lift them under each kind of contacts, and print how many survive."""
    bundle = run.with_name(f"{run.name}-bundle")
    qdgrasp("export", run, "--format", "bundle", "--min-fitness", 0, "-o", bundle, "--force")
    for contacts in CONTACTS:
        result = replayed(bundle, asked.grasps, contacts)
        held, survived, eta = result["held"], result["survived"], result["eta"]
        words = [f"held {share(survived[held])}", f"not held {share(survived[~held])}"]
        words.append(f"AUC of held {auc(held.astype(float), survived):.2f}")
        if (known := ~np.isnan(eta)).any():
            words = [f"AUC of eta {auc(eta[known], survived[known]):.2f}"]
            for low, high in ETAS:
                words.append(f"eta {low:g} on: {share(survived[known & (eta >= low) & (eta < high)])}")
        print(f"{run.name}, {contacts}: {', '.join(words)}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.elsewhere", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("elsewhere"), help="folder of runs and bundles")
    parser.add_argument("--grasps", type=int, default=60, help="grasps of each set, at most")
    parser.add_argument("--evaluations", type=int, default=300, help="evaluations of the default search")
    parser.add_argument("--trials", type=int, default=20, help="trials of each of the best grasps; 0: none")
    parser.add_argument("--object", choices=("mug", "mallet"), help="one of the two alone")
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--workers", type=int, default=1)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    mallet(asked.out / "mallet.stl")
    things: dict[str, Sequence[object]] = {
        "mug": ("mug",),
        "mallet": (asked.out / "mallet.stl", "--mass", 0.35),
    }
    for name in [asked.object] if asked.object else things:
        for method in METHODS:
            run = found(asked.out, things[name], name, method, asked)
            report(run, asked)
            if asked.trials and method == DEFAULT:
                report(scored(run, asked), asked)
                report(scored(run, asked, "--no-reseat"), asked)


if __name__ == "__main__":
    main()
