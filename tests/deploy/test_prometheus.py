"""Alert rules and dashboard ask for metrics of a monitor, and Prometheus can read them."""

import json
import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from msgspec import structs
from prometheus_client.parser import text_string_to_metric_families
from tests.deploy.commands import DEPLOY
from tests.deploy.promql import TEMPLATE, Alert, data, firing, read, seconds
from tests.tools.monitor.sample_jobs import run, values, views

from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.monitor.prometheus import STATES, exposition

PROMETHEUS = DEPLOY / "prometheus"
BOARD = json.loads((DEPLOY / "grafana" / "qdgrasp.json").read_text())
RULES = yaml.safe_load((PROMETHEUS / "alerts.yml").read_text())["groups"][0]["rules"]
ALERT_TESTS = yaml.safe_load((PROMETHEUS / "alerts_test.yml").read_text())["tests"]
PROMTOOL = shutil.which("promtool")
needs_promtool = pytest.mark.skipif(
    PROMTOOL is None, reason="promtool (Debian's package prometheus) is not here; others check the same"
)
ASKED = re.compile(r"(qdgrasp_[a-z_]+)(?:\{(.*?)\})?")
LABEL = re.compile(r"(\w+)(=~|=)\"(.*?)\"")
GROUPING = re.compile(r"\b(?:by|on) \((.*?)\)")
VARIABLES = {"$__rate_interval": "1m", "$job": ".*", "$run": ".*", "$host": ".*"}


@pytest.fixture(scope="module")
def told() -> dict[str, set[str]]:
    """The labels of every metric that a monitor tells, by its name."""
    (view,) = views(values())
    whole = structs.replace(view, runs=[run("a", outcomes={one.name.lower(): 1 for one in Outcome})])
    text = exposition([whole])[0].decode()
    samples = [sample for one in text_string_to_metric_families(text) for sample in one.samples]
    return {sample.name: set(sample.labels) for sample in samples}


def panels() -> list[dict[str, Any]]:
    return [panel for panel in BOARD["panels"] if panel["type"] != "row"]


def questions() -> Iterator[str]:
    """All queries of dashboard and rules to Prometheus."""
    yield from (rule["expr"] for rule in RULES)
    yield from (target["expr"] for panel in panels() for target in panel["targets"])
    yield from (note["expr"] for note in BOARD["annotations"]["list"])
    yield from (one["definition"] for one in BOARD["templating"]["list"] if one["type"] == "query")


@pytest.mark.parametrize("question", list(questions()))
def test_what_is_asked_for_is_told(told: dict[str, set[str]], question: str) -> None:
    for name, chosen in ASKED.findall(question):
        assert name in told
        assert {label for label, _, _ in LABEL.findall(chosen)} <= told[name]
    labels = {each.strip() for group in GROUPING.findall(question) for each in group.split(",")}
    assert labels <= set().union(*told.values())


def test_states_and_outcomes_that_are_asked_for_can_be() -> None:
    known = {
        "state": {*STATES, "working", "idle", "stuck", "leaving", "gone"},
        "outcome": {one.name.lower() for one in Outcome},
    }
    asked = [(label, value) for question in questions() for label, _, value in LABEL.findall(question)]
    named = [(label, one) for label, value in asked if label in known for one in value.split("|")]
    assert len(named) > 5
    assert all(value in known[label] for label, value in named)


def test_every_outcome_has_a_colour_of_its_own() -> None:
    (panel,) = [panel for panel in panels() if panel["title"] == "Where evaluations end"]
    colours = {
        each["matcher"]["options"]: each["properties"][0]["value"]
        for each in panel["fieldConfig"]["overrides"]
    }
    assert set(colours) == {one.name.lower() for one in Outcome}
    assert len({colour["fixedColor"] for colour in colours.values()}) == len(Outcome)


def test_a_dashboard_says_each_thing_once_and_where_it_comes_from() -> None:
    ids = Counter(panel["id"] for panel in BOARD["panels"])
    assert max(ids.values()) == 1
    assert len({panel["title"] for panel in BOARD["panels"]}) == len(BOARD["panels"])
    for panel in panels():
        assert panel["description"]
        assert panel["datasource"]["uid"] == "${datasource}"
        refs = [target["refId"] for target in panel["targets"]]
        assert len(set(refs)) == len(refs)
    variables = [one["name"] for one in BOARD["templating"]["list"]]
    assert variables == ["datasource", "job", "run", "host"]
    asked = {word for question in questions() for word in re.findall(r"\$(\w+)", question)}
    assert asked - {"__rate_interval", "labels", "value"} <= set(variables)


def test_panels_lie_beside_one_another() -> None:
    places = [panel["gridPos"] for panel in BOARD["panels"]]
    squares = Counter(
        (x, y)
        for at in places
        for x in range(at["x"], at["x"] + at["w"])
        for y in range(at["y"], at["y"] + at["h"])
    )
    assert max(squares.values()) == 1
    assert max(x for x, _ in squares) < 24


def test_every_alert_is_tested() -> None:
    checks = [check for test in ALERT_TESTS for check in test["alert_rule_test"]]
    fired = {check["alertname"] for check in checks if check.get("exp_alerts")}
    asked = [check for test in ALERT_TESTS for check in test.get("promql_expr_test", [])]
    samples = str([check["exp_samples"] for check in asked])
    assert fired | set(re.findall(r'alertname="(\w+)"', samples)) == {rule["alert"] for rule in RULES}


def test_the_page_about_watching_names_every_alert_and_every_metric(told: dict[str, set[str]]) -> None:
    page = (DEPLOY.parent / "docs" / "watching.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `(Qdgrasp\w+)` \|", page, re.MULTILINE)) == {rule["alert"] for rule in RULES}
    cells = re.findall(r"`(qdgrasp_[a-z_]*)(?:\{(.*?)\})?([a-z_.]*)`", page)
    named = {f"{head}{part}{tail}" for head, parts, tail in cells for part in parts.split(",")}
    stems = tuple(name.removesuffix("...") for name in named if name.endswith("..."))
    assert {name for name in told if not name.startswith(stems)} <= named
    assert {name for name in named if not name.endswith("...")} <= set(told)


def filled() -> Iterator[str]:
    """All questions to Prometheus itself, with values for their variables."""
    for question in questions():
        for name, value in VARIABLES.items():
            question = question.replace(name, value)
        if not question.startswith("label_values"):
            yield question


@pytest.mark.parametrize("question", list(filled()))
def test_prometheus_could_read_what_is_asked_for(question: str) -> None:
    read(question)


@pytest.mark.parametrize(
    "question",
    [
        *("rate(a)", "sum by job (a)", "a ==", "a[5m] > 1", "foo(a)", 'a{b="c}', "(a", "a b", 'a{b=~"("}'),
        *("", "sum(a[5m])", "a and and b", "a{b}", "increase(a[5])", "1 + a[5m]", "sum by (job a)"),
    ],
)
def test_what_prometheus_could_not_read_is_noticed(question: str) -> None:
    with pytest.raises((ValueError, re.error)):
        read(question)


def test_the_configuration_scrapes_a_monitor_and_knows_the_rules() -> None:
    settings = yaml.safe_load((PROMETHEUS / "prometheus.yml").read_text())
    assert {*settings} == {"global", "rule_files", "scrape_configs"}
    assert {*settings["global"]} == {"scrape_interval", "evaluation_interval"}
    assert all(seconds(value) > 0 for value in settings["global"].values())
    assert all((PROMETHEUS / name).is_file() for name in settings["rule_files"])
    (job,) = settings["scrape_configs"]
    assert {*job} == {"job_name", "honor_labels", "static_configs"}
    assert job["honor_labels"] is True
    assert all(
        re.fullmatch(r"[\w.]+:\d+", place) for one in job["static_configs"] for place in one["targets"]
    )


def test_every_alert_waits_has_a_severity_and_says_what_is_the_matter_and_nothing_else() -> None:
    (group,) = yaml.safe_load((PROMETHEUS / "alerts.yml").read_text())["groups"]
    assert {*group} == {"name", "rules"}
    for rule in RULES:
        assert {*rule} == {"alert", "expr", "for", "labels", "annotations"}
        assert rule["alert"].startswith("Qdgrasp")
        assert re.fullmatch(r"\d+m", rule["for"])
        assert rule["labels"] in ({"severity": "warning"}, {"severity": "critical"})
        assert set(rule["annotations"]) == {"summary", "description"}
        for words in rule["annotations"].values():
            assert set(TEMPLATE.sub("", words)).isdisjoint("{}")


def test_what_alerts_name_is_what_their_questions_leave(told: dict[str, set[str]]) -> None:
    everywhere = set.union(*told.values()) | {"instance"}
    for rule in RULES:
        named = {label for words in rule["annotations"].values() for _, label, _ in TEMPLATE.findall(words)}
        assert named - {""} <= everywhere


@pytest.mark.parametrize("test", ALERT_TESTS, ids=[test["name"] for test in ALERT_TESTS])
def test_alerts_come_when_they_should(test: dict[str, Any]) -> None:
    step = seconds(test["interval"])
    series = data(test["input_series"], step)
    for check in test["alert_rule_test"]:
        (rule,) = [rule for rule in RULES if rule["alert"] == check["alertname"]]
        expected = [
            Alert(frozenset(one["exp_labels"].items()), tuple(sorted(one["exp_annotations"].items())))
            for one in check.get("exp_alerts", [])
        ]
        assert firing(rule, series, seconds(check["eval_time"]), step) == expected
    for check in test.get("promql_expr_test", []):
        until = seconds(check["eval_time"])
        state = {("alertstate", "firing")}
        fired = {
            ("ALERTS", one.labels | state | {("alertname", rule["alert"])}): [(until, 1.0)]
            for rule in RULES
            for one in firing(rule, series, until, step)
        }
        found = read(check["expr"])(fired, until)
        assert found == {
            frozenset((name, text) for name, _, text in LABEL.findall(one["labels"])): one["value"]
            for one in check["exp_samples"]
        }


def promtool(*arguments: str, folder: Path = PROMETHEUS) -> None:
    done = subprocess.run([str(PROMTOOL), *arguments], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@needs_promtool
def test_promtool_takes_the_configuration_and_the_rules_and_agrees_on_when_alerts_come() -> None:
    promtool("check", "config", "prometheus.yml")
    promtool("test", "rules", "alerts_test.yml")


@needs_promtool
def test_promtool_can_read_what_the_dashboard_asks_for(tmp_path: Path) -> None:
    rules = [{"record": f"panel{number}", "expr": question} for number, question in enumerate(filled())]
    (tmp_path / "board.yml").write_text(yaml.safe_dump({"groups": [{"name": "board", "rules": rules}]}))
    promtool("check", "rules", "board.yml", folder=tmp_path)
