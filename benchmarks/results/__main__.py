"""The table of results: `make results`, or `python -m benchmarks.results`."""

from pathlib import Path
from typing import Annotated

import typer
from benchmarks.results.assets import FILES, NAME, make_asset
from benchmarks.results.measure import HEX, codes_here
from benchmarks.results.programme import HOME, Costs, chosen, ordered, programme
from benchmarks.results.work import Store, run_missing

from qdgrasp_protocol.cli_support import run_command
from qdgrasp_protocol.process import lifetime
from qdgrasp_tools.cli import options
from qdgrasp_tools.local.supervisor import LocalJobConfig

ROOT = Path(__file__).resolve().parents[2]
TABLE = ROOT / "docs" / "results" / "runs.csv"
RUNS = ROOT / "runs" / "results"

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
Table = Annotated[Path, typer.Option(help="The table; its page lies beside it.")]
Home = Annotated[Path, typer.Option("--programme", help="The folder of the programme's campaigns.")]
Accept = Annotated[
    list[str] | None,
    typer.Option(help="Digest of an older evaluation code whose verdicts are the same; may be given again."),
]
Campaigns = Annotated[list[str] | None, typer.Argument(help="Campaigns of the programme; default: all.")]
Cells = Annotated[
    list[str] | None,
    typer.Option("--cell", metavar="TEXT", help="Only runs with it in their name; may be given again."),
]
Runs = Annotated[Path, typer.Option(help="Where the folders of runs, and of made assets, go.")]
Folders = Annotated[list[Path], typer.Argument(metavar="DIR...", help="Folders of campaigns or runs.")]


@app.command()
def run(
    campaigns: Campaigns = None,
    cell: Cells = None,
    accept: Accept = None,
    table: Table = TABLE,
    home: Home = HOME,
    runs: Runs = RUNS,
    workers: options.Workers = None,
) -> None:
    """Carry out missing runs, the cheapest scene first, and evaluate drawn grasps of the benchmark's.

    If stopped, the same command goes on.
    """
    store = _store(table, home, accept)
    asked = chosen(store.known, campaigns or (), cell or ())
    with lifetime("qdgrasp results") as stop:
        failures = run_missing(store, asked, runs, LocalJobConfig(workers=workers or options.cores()), stop)
    typer.echo(f"{len(store.missing(asked))} of {len(asked.wanted)} runs are missing.")
    if stop.is_set:
        typer.echo("Stopped; the same command goes on.", err=True)
        raise typer.Exit(stop.exit_code)
    for other in failures[1:]:
        typer.echo(str(other), err=True)
    if failures:
        raise failures[0]


@app.command("list")
def show(
    campaigns: Campaigns = None,
    cell: Cells = None,
    accept: Accept = None,
    table: Table = TABLE,
    home: Home = HOME,
) -> None:
    """Print the missing runs in their order of execution, and carry out none."""
    store = _store(table, home, accept)
    asked, costs = chosen(store.known, campaigns or (), cell or ()), Costs(store.table.values())
    left = store.missing(asked)
    for one in ordered(left, costs):
        typer.echo(f"{costs.seconds(one.key):7.0f} CPU s  {one.key.words}")
    total = sum(costs.seconds(one.key) for one in left)
    typer.echo(f"{len(left)} runs are missing, about {total / 3600:.1f} CPU hours.")


@app.command()
def add(directories: Folders, accept: Accept = None, table: Table = TABLE, home: Home = HOME) -> None:
    """Add finished runs in folders; only rows of today's evaluation code replace such rows."""
    typer.echo(_store(table, home, accept).add(directories).words)


@app.command()
def assets(runs: Runs = RUNS) -> None:
    """Make the benchmark's own hands and objects, and print their folder."""
    for file in FILES:
        make_asset(runs / NAME / file)
        typer.echo(str(runs / NAME / file))


@app.command()
def page(table: Table = TABLE, home: Home = HOME) -> None:
    """Make the page of the table again."""
    _store(table, home, None).write_page()


def _store(table: Path, home: Path, accept: list[str] | None) -> Store:
    current = codes_here() | {digest[:HEX] for digest in accept or ()}
    return Store(table, programme(home), current)


def main() -> None:
    """Entry point."""
    run_command(app, "results")


if __name__ == "__main__":
    main()
