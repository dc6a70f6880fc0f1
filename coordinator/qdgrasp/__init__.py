"""Archives of diverse, robust 6-DoF grasps by distributed quality-diversity search.

Names for programs (docs/python.md):

* `open(path)`            a run's folder: its spec, its scene, its figures, its grasps as arrays; or a
                         campaign's: its runs, one after the other
* `Hand(gripper)`         a hand: its joints, its shapes as a scene
* `evaluate(...)`         scores of hand poses
* `Evaluations(...)`      rows of genomes, whenever an optimiser of one's own wants some
* `optimise(search, ...)` a run with a search of one's own, asked and told in order, and its folder
* `serve(evaluator)`      an evaluator of one's own, as a worker on the bus

`Place` says where workers run. Modules are loaded when they are first used. Notebooks show runs, campaigns,
grasps and hands as pictures with their key figures.
"""

TYPE_CHECKING = False  # that of `typing`, which takes longer to load than all that is here
if TYPE_CHECKING:
    from qdgrasp.backend import Place as Place
    from qdgrasp.evaluations import Evaluations as Evaluations
    from qdgrasp.evaluations import evaluate as evaluate
    from qdgrasp.evaluator_worker import serve as serve
    from qdgrasp.hand import Hand as Hand
    from qdgrasp.optimisation import Search as Search
    from qdgrasp.optimisation import optimise as optimise
    from qdgrasp.runs import CampaignRuns as CampaignRuns
    from qdgrasp.runs import Run as Run
    from qdgrasp.runs import open as open  # noqa: A004  # said as qdgrasp.open
    from qdgrasp_assets.scene import Scene as Scene
    from qdgrasp_protocol.errors import InputError as InputError
    from qdgrasp_protocol.errors import QdgraspError as QdgraspError
    from qdgrasp_protocol.rows import Genomes as Genomes
    from qdgrasp_protocol.rows import Layout as Layout
    from qdgrasp_protocol.rows import Outcome as Outcome
    from qdgrasp_protocol.rows import Rows as Rows
    from qdgrasp_protocol.spec import RunSpec as RunSpec
    from qdgrasp_tools.export.grasp_set import Grasp as Grasp
    from qdgrasp_tools.export.grasp_set import Grasps as Grasps
    from qdgrasp_worker.runtime.evaluator_api import Hands as Hands
    from qdgrasp_worker.runtime.evaluator_api import Verdicts as Verdicts

HOMES = {
    "CampaignRuns": "qdgrasp.runs",
    "Evaluations": "qdgrasp.evaluations",
    "Genomes": "qdgrasp_protocol.rows",
    "Grasp": "qdgrasp_tools.export.grasp_set",
    "Grasps": "qdgrasp_tools.export.grasp_set",
    "Hand": "qdgrasp.hand",
    "Hands": "qdgrasp_worker.runtime.evaluator_api",
    "InputError": "qdgrasp_protocol.errors",
    "Layout": "qdgrasp_protocol.rows",
    "Outcome": "qdgrasp_protocol.rows",
    "Place": "qdgrasp.backend",
    "QdgraspError": "qdgrasp_protocol.errors",
    "Rows": "qdgrasp_protocol.rows",
    "Run": "qdgrasp.runs",
    "RunSpec": "qdgrasp_protocol.spec",
    "Scene": "qdgrasp_assets.scene",
    "Search": "qdgrasp.optimisation",
    "Verdicts": "qdgrasp_worker.runtime.evaluator_api",
    "evaluate": "qdgrasp.evaluations",
    "open": "qdgrasp.runs",
    "optimise": "qdgrasp.optimisation",
    "serve": "qdgrasp.evaluator_worker",
}
"""The module of each name, loaded when the name is used first."""

__version__: str


def __getattr__(name: str) -> object:
    from importlib import import_module

    if name == "__version__":
        value: object = import_module("importlib.metadata").version("qdgrasp")
    elif name in HOMES:
        value = getattr(import_module(HOMES[name]), name)
    else:
        raise AttributeError(f"module 'qdgrasp' has no attribute '{name}'; it has {', '.join(__dir__())}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*HOMES, "__version__"]
