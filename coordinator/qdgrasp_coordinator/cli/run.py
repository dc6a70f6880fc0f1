"""`qdgrasp run`: fill an archive of grasps."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from qdgrasp_assets.units import scale_of
from qdgrasp_coordinator.campaigns.summary import summary
from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.cli.carrying import carry_out, check_not_stopped, going_on
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.keeping.ranking import is_reranking, write_ranking
from qdgrasp_coordinator.runs import preparation
from qdgrasp_coordinator.watching.progress import display
from qdgrasp_coordinator.watching.supervisor import Door, Team
from qdgrasp_protocol import flags
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.lifetime import Stop, lifetime
from qdgrasp_protocol.spec import DEFAULT_METHOD, RunSpec, read_run_spec


def run(
    spec: Annotated[
        Path | None, typer.Argument(metavar="SPEC.toml", help="A spec; flags replace what it says.")
    ] = None,
    gripper: options.Gripper = None,
    object_: options.Object = None,
    mass: options.Mass = None,
    scale: options.Scale = None,
    units: options.Units = None,
    friction: options.Friction = None,
    method: Annotated[str | None, typer.Option(help=f"Search method; default {DEFAULT_METHOD}.")] = None,
    protocol: options.ProtocolOption = None,
    evaluations: Annotated[int | None, typer.Option(help="Counted evaluations; default 10000.")] = None,
    successes: options.Successes = None,
    no_new_cell: options.NoNewCell = None,
    seconds: options.Seconds = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the search; default 0.")] = None,
    overlaps: Annotated[
        str | None,
        typer.Option(
            help="count: every pose is an evaluation; redraw: simulated ones are; default: the method's."
        ),
    ] = None,
    population: Annotated[
        int | None,
        typer.Option(help="Genomes in a generation; default: the method's, see `qdgrasp methods`."),
    ] = None,
    mutation_sigma: Annotated[
        float | None, typer.Option(help="Of the Gaussian mutation; default 0.1.")
    ] = None,
    mutation_probability: Annotated[float | None, typer.Option(help="Of each gene; default 0.3.")] = None,
    generations_in_flight: Annotated[
        int | None, typer.Option(help="Generations asked before the first is told; default: the method's.")
    ] = None,
    surface_seed: Annotated[int | None, typer.Option(help="Seed of the surface points; default 0.")] = None,
    workers: options.Workers = None,
    batch_size: options.BatchSize = None,
    listen: options.Listen = None,
    security: flags.Security = None,
    insecure: flags.Insecure = False,
    job: Annotated[str | None, typer.Option(help="Name on the bus; default: the folder's name.")] = None,
    out: Annotated[Path | None, typer.Option(help="Run folder; default runs/<what it is>.")] = None,
    disk_wait: options.DiskWait = 60.0,
) -> None:
    """Fill an archive of grasps: a coordinator, a recorder and workers on this machine.

    Example: qdgrasp run --gripper panda --object mug --evaluations 10000 --seed 1
    """
    flags = {
        "gripper": gripper,
        "object": object_,
        "mass": mass,
        "scale": scale_of(units, scale),
        "friction": friction,
        "method": method,
        "protocol": protocol,
        "evaluations": evaluations,
        "successes": successes,
        "no_new_cell": no_new_cell,
        "seed": seed,
        "overlaps": overlaps,
        "population": population,
        "mutation_sigma": mutation_sigma,
        "mutation_probability": mutation_probability,
        "generations_in_flight": generations_in_flight,
        "surface_seed": surface_seed,
    }
    asked = preparation.full_spec(_merged(spec, flags), str(spec) if spec else "run")
    door = Door(listen, security, insecure)
    count = options.cores() if workers is None else workers
    team = Team(count, batch_size, door, disk_wait, seconds)
    start(asked, out or Path("runs") / preparation.default_name(asked), team, job)


def start(
    spec: RunSpec,
    out: Path,
    team: Team,
    job: str | None = None,
    begun: Callable[[RunFolder], None] = lambda _folder: None,
) -> None:
    """Begin a run in a new folder and carry it out; `begun` is called in between."""
    RunFolder.check_free(out)
    with display(out.name, spec.evaluations) as shown:
        shown.say(f"building the scene of {spec.gripper} and {spec.object}")
        _, bundle = preparation.make_bundle(spec)
        with lifetime("qdgrasp run") as stop:
            folder = RunFolder.create(out, spec, bundle, job=job)
            begun(folder)
            carry_out(folder.job, team, shown, stop)
    finish(folder, stop)


def finish(folder: RunFolder, stop: Stop) -> None:
    """Print what was found, or end as a signal has asked."""
    check_not_stopped(folder.job, stop)
    found = summary(folder)
    typer.echo(found.words)
    if not found.complete:
        typer.echo(f"It is not finished; {going_on(folder.job)}")
    elif found.evaluations < found.budget:
        typer.echo(f"It ended early: {found.ended}.")
    show_ranking(folder)


def show_ranking(folder: RunFolder) -> None:
    """Rank the grasps of a complete run that has scored them again."""
    if is_reranking(folder):
        typer.echo(write_ranking(folder))


def _merged(spec: Path | None, flags: dict[str, Any]) -> dict[str, Any]:
    values = read_run_spec(spec) if spec else {}
    if "cross" in values:
        raise InputError(f"{spec} asks for many runs: `qdgrasp campaign {spec}` carries them out.")
    return values | {name: value for name, value in flags.items() if value is not None}
