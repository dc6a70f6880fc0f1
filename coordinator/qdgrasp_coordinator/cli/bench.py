"""`qdgrasp bench`: how fast this node is."""

import json
import tempfile
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from qdgrasp_assets.units import scale_of
from qdgrasp_coordinator.bench.course import Course, Measured
from qdgrasp_coordinator.bench.figures import NodeFigures
from qdgrasp_coordinator.bench.node import node
from qdgrasp_coordinator.bench.regimes import METHOD
from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.runs.preparation import full_spec, make_bundle
from qdgrasp_coordinator.watching.progress import PlainLines
from qdgrasp_coordinator.watching.workers import GRACE
from qdgrasp_protocol.crew import Crew
from qdgrasp_protocol.lifetime import lifetime
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.zenoh_bus import ZenohBus

OBJECTS = ("rubiks_cube", "mug")


def bench(
    gripper: Annotated[str, typer.Option(help="Gripper: a built-in name or a TOML file.")] = "panda",
    objects: Annotated[
        list[str] | None,
        typer.Option(
            "--object", help="Object: a built-in name or a mesh file; may be repeated. Default: two."
        ),
    ] = None,
    mass: options.Mass = None,
    scale: options.Scale = None,
    units: options.Units = None,
    protocol: options.ProtocolOption = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Worker processes; default: one per core.")
    ] = None,
    seconds: Annotated[
        float, typer.Option(min=0.1, max=3600, help="How long each regime is measured.")
    ] = 4.0,
    as_json: options.Json = False,
) -> None:
    """Measure what this node makes of evaluations: with one worker, and with all.

    A job is carried out as `qdgrasp run` does it, but nothing is kept. Poses anywhere are mostly rejected at
    once; poses near grasps are mostly shaken to the end. Any run lies between the two.

    Example: qdgrasp bench --gripper allegro --object mug --object banana --workers 4
    """
    given = {
        "gripper": gripper,
        "mass": mass,
        "scale": scale_of(units, scale),
        "protocol": protocol,
        "method": METHOD,
    }
    values = {name: value for name, value in given.items() if value is not None}
    specs = [full_spec(values | {"object": name}, "bench") for name in objects or OBJECTS]
    count, here = options.cores() if workers is None else workers, node()
    found = [_measure(spec, count, seconds) for spec in specs]
    figures = NodeFigures(
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        node=here,
        platform=found[0].platform,
        scenes=[scene.figures for scene in found],
    )
    typer.echo(json.dumps(msgspec.to_builtins(figures)) if as_json else figures.table)


def _measure(spec: RunSpec, workers: int, seconds: float) -> Measured:
    """Measure one scene with workers of its own.

    Raises
    ------
    Exit
        There was a signal to stop.
    """
    lines = PlainLines("bench")
    lines.say(f"building the scene of {spec.gripper} and {spec.object}")
    scene, bundle = make_bundle(spec)
    course = Course(spec, scene, bundle, workers=workers, seconds=seconds, display=lines)
    with lifetime("qdgrasp bench") as stop, ExitStack() as stack:
        logs = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="qdgrasp-")))
        bus, endpoint = ZenohBus.embedded(None)
        stack.enter_context(bus)
        measured = course.run(bus, endpoint, stack.enter_context(Crew(logs, GRACE)), stop)
    if measured is None:
        raise typer.Exit(stop.exit_code)
    return measured
