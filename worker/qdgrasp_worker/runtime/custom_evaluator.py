"""The simulator's process with a user's evaluator instead of Bullet (docs/python.md).

Started as `python -m qdgrasp_worker.runtime.custom_evaluator FILE.py:NAME` or `MODULE:NAME`. Batches, limits
and restarts are those of the package's own simulator; poses are decoded here, by the same code.
"""

import hashlib
import inspect
import sys
from collections import ChainMap
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import cast

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.scene import Scene, unpack_scene
from qdgrasp_protocol import messages
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import RESULT, Outcome, Rows
from qdgrasp_worker.decoder import DecodedGrasps
from qdgrasp_worker.episode import EpisodeResult
from qdgrasp_worker.evaluator import ROWS_AT_ONCE, BatchEvaluator, fill_rows
from qdgrasp_worker.platform import base_platform
from qdgrasp_worker.runtime.evaluator_api import EvaluatorFactory, EvaluatorFn, Hands
from qdgrasp_worker.runtime.simulator_main import main as serve


class CustomEvaluator(BatchEvaluator):
    """Evaluates one scene by a user's function, made by `make` and closed with it."""

    def __init__(self, scene: Scene, make: EvaluatorFactory) -> None:
        super().__init__(scene, shortcuts=False)
        self._verdicts: EvaluatorFn = make(scene)
        self.at_once = max(1, int(getattr(self._verdicts, "at_once", ROWS_AT_ONCE)))

    def close(self) -> None:
        """Close the user's function if it can be closed."""
        getattr(self._verdicts, "close", lambda: None)()

    def _judge(self, prior: str, rows: Rows, grasps: DecodedGrasps, places: list[int]) -> dict[int, str]:
        fill_rows(rows, grasps, {i: EpisodeResult(Outcome.MISSED, grasps[i].joints) for i in places})
        return self._fill(rows, self._hands(prior, rows, grasps, places), np.array(places))

    def _hands(self, prior: str, rows: Rows, grasps: DecodedGrasps, places: list[int]) -> Hands:
        disturbed = [self._protocol.trial(grasps[i], int(rows["trial"][i])) for i in places]
        usual = (self.scene.object.rolling_friction, self.scene.object.spinning_friction)
        poses = [[*trial.pose.position, *trial.pose.quaternion] for trial in disturbed]
        return Hands(
            base_to_object=np.array(poses, dtype=np.float32),
            joints=grasps.joints[places],
            synergies=grasps.synergies[places],
            frictions=np.array([trial.frictions or usual for trial in disturbed]),
            trials=rows["trial"][places],
            surface_points=grasps.surface_points[places],
            prior=prior,
            genomes=rows["genome"][places],
        )

    def _fill(self, rows: Rows, hands: Hands, places: NDArray[np.intp]) -> dict[int, str]:
        """Fill the rows at these places with verdicts; where that fails, one by one."""
        try:
            columns = self._verdicts(hands).columns(hands, self._protocol.disturbances)
        except Exception as error:  # noqa: BLE001  # any failure is these rows' result and no other's
            if len(places) > 1:
                alone = [slice(i, i + 1) for i in range(len(places))]
                return dict(ChainMap(*(self._fill(rows, hands[one], places[one]) for one in alone)))
            for column in RESULT:
                rows[column.name][places] = 0
            return {int(places[0]): f"{type(error).__name__}: {error}"}
        for name, values in columns.items():
            rows[name][places] = values
        return {}


def load_evaluator(what: str) -> tuple[EvaluatorFactory, Path]:
    """Return the evaluator of that name and its file; an InputError if it cannot be loaded."""
    where, _, name = what.rpartition(":")
    try:
        module = _module_from_file(Path(where)) if where.endswith(".py") else import_module(where)
        found: object = module
        for part in name.split("."):
            found = getattr(found, part)
    except (ImportError, OSError, AttributeError) as error:
        raise InputError(f"No evaluator can be loaded from '{what}': {error}.") from None
    return cast(EvaluatorFactory, found), Path(str(inspect.getsourcefile(module)))


def _module_from_file(path: Path) -> ModuleType:
    """Load the module in a file, which may import its neighbours; it is not run as a script."""
    sys.path.insert(0, str(path.parent))
    spec = spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no module")
    module = sys.modules[path.stem] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def custom_platform(what: str, file: Path) -> dict[str, str]:
    """All that decides the bits of results: the evaluator's file and the decoding code."""
    return base_platform() | {
        "evaluator": what.rpartition(":")[2],
        "evaluator_file": hashlib.sha256(file.read_bytes()).hexdigest(),
    }


def main() -> None:
    """Entry point of the simulator."""
    what = sys.argv[1]
    found: list[tuple[EvaluatorFactory, Path]] = []

    def probe() -> dict[str, str]:
        found.append(load_evaluator(what))
        return custom_platform(what, found[0][1])

    def evaluator(bundle: bytes) -> BatchEvaluator:
        messages.check_bundle(bundle)
        return CustomEvaluator(unpack_scene(bundle), found[0][0])

    serve(load=evaluator, probe=probe)


if __name__ == "__main__":
    main()
