"""The entry of a run: what it is, and what its rows add up to, for whoever lists runs."""

from typing import Annotated

from msgspec import Meta, Struct, structs

from qdgrasp_coordinator.counts.curve import Curve
from qdgrasp_coordinator.counts.tally import Tally
from qdgrasp_coordinator.counts.totals import Totals, totals
from qdgrasp_protocol.spec import RunSpec

PAGE = 256
"""The most entries in one answer."""


class RunEntry(Totals, frozen=True, kw_only=True):
    """What a run is, and what its rows add up to: of one in progress, or of one in a job's folder."""

    run: Annotated[str, Meta(description="Its name in its job.")]
    gripper: Annotated[str, Meta(description="As the spec names it: built in, or a file.")]
    object: Annotated[str, Meta(description="As the spec names it: built in, on the asset path, or a file.")]
    method: Annotated[str, Meta(description="The search with its prior.")]
    protocol: Annotated[str, Meta(description="The evaluation protocol.")]
    seed: Annotated[int, Meta(description="Of the search.")]
    scene: Annotated[str, Meta(description="sha256 of the scene bundle.")]
    budget: Annotated[int, Meta(description="Counted evaluations after which it is over.")]
    rows: Annotated[int, Meta(description="Journal rows: genomes and trials.")]
    outcomes: Annotated[
        dict[str, int],
        Meta(
            description="Genomes by how their nominal evaluation ended: "
            "each `Outcome` by its name in lower case."
        ),
    ]
    finished: Annotated[str, Meta(description="Why the run is over, in words; empty while it is not.")] = ""
    folder: Annotated[
        str,
        Meta(
            description="Its folder on the recorder's machine, absolute; "
            "empty where a coordinator tells of it."
        ),
    ] = ""

    @classmethod
    def of(cls, run: str, spec: RunSpec, scene: str, found: Tally) -> "RunEntry":
        """That of a run by its name, spec, scene and the tally of its rows."""
        return RunEntry(
            **structs.asdict(totals(found)),
            run=run,
            gripper=spec.gripper,
            object=spec.object,
            method=spec.method,
            protocol=spec.protocol,
            seed=spec.seed,
            scene=scene,
            budget=found.budget,
            rows=found.rows,
            outcomes=found.outcomes,
            finished=found.finished or "",
        )


class RunEntries(Struct, frozen=True, kw_only=True):
    """Runs in a job's folder, also finished ones, by name. JSON, the answer to a query on `rec/runs`."""

    runs: Annotated[list[RunEntry], Meta(description="Those whose rows are counted.")]
    next: Annotated[
        int, Meta(description="Ask with `from=<next>` for the runs behind these; 0: there are none.")
    ] = 0
    uncounted: Annotated[
        int,
        Meta(description="Runs left out because their rows are still being counted: ask again in a while."),
    ] = 0
    host: Annotated[str, Meta(description="The recorder's machine.")] = ""
    curve: Annotated[
        Curve | None,
        Meta(
            description="How the one run grew that was asked for; "
            "None where all were, or where its rows are not all there."
        ),
    ] = None
