"""What the workers of one command are started with."""

import typer.main

from qdgrasp_worker.cli import app
from qdgrasp_worker.serving.team import OUR_OWN, arguments


def parsed(given: list[str]) -> typer.Context:
    return typer.main.get_command(app).make_context("qdgrasp-worker", list(given))


def test_workers_of_a_team_are_started_with_the_options_of_the_team_but_for_its_own():
    given = [
        "--connect",
        "tls/a:1,tls/b:2",
        "--security",
        "here",
        "--workers",
        "4",
        "--pin",
        "--grace",
        "9.5",
    ]
    team = parsed(given)
    member = parsed(arguments(team))
    changed = {name for name, value in team.params.items() if member.params[name] != value}
    assert changed == set(OUR_OWN)
    assert (member.params["workers"], member.params["pin"]) == (1, False)


def test_nothing_is_made_of_what_was_not_given():
    assert "--job" not in arguments(parsed(["--workers", "2"]))
    assert "--self-test" not in arguments(parsed(["--workers", "2"]))
