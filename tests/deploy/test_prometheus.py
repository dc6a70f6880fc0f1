"""Alert rules and dashboard ask for metrics of a monitor, and Prometheus can read them."""

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from msgspec import structs
from prometheus_client.parser import text_string_to_metric_families
from tests.deploy.commands import DEPLOY
from tests.tools.monitor.sample_jobs import run, values, views

from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.monitor.prometheus import exposition

PROMETHEUS = DEPLOY / "prometheus"
BOARD = json.loads((DEPLOY / "grafana" / "qdgrasp.json").read_text())
RULES = yaml.safe_load((PROMETHEUS / "alerts.yml").read_text())["groups"][0]["rules"]
METRIC = re.compile(r"(qdgrasp_[a-z_]+)(?:\{(.*?)\})?")
LABEL = re.compile(r"(\w+)=~?\"")
VARIABLES = {"$__rate_interval": "1m", "$job": ".*", "$run": ".*", "$host": ".*"}


def queries() -> Iterator[str]:
    """All queries of dashboard and rules, with values for their variables."""
    shown = [rule["expr"] for rule in RULES]
    shown += [target["expr"] for panel in BOARD["panels"] for target in panel.get("targets", [])]
    shown += [note["expr"] for note in BOARD["annotations"]["list"]]
    for query in shown:
        for name, value in VARIABLES.items():
            query = query.replace(name, value)
        yield query


def test_each_queried_metric_and_label_is_exported() -> None:
    (view,) = views(values())
    whole = structs.replace(view, runs=[run("a", outcomes={one.name.lower(): 1 for one in Outcome})])
    families = text_string_to_metric_families(exposition([whole])[0].decode())
    exported = {sample.name: set(sample.labels) for one in families for sample in one.samples}
    for query in queries():
        for name, labels in METRIC.findall(query):
            assert name in exported
            assert set(LABEL.findall(labels)) <= exported[name]


@pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool (Debian's prometheus) is not here")
def test_promtool_accepts_configuration_rules_and_dashboard(tmp_path: Path) -> None:
    rules = [{"record": f"panel{number}", "expr": query} for number, query in enumerate(queries())]
    (tmp_path / "board.yml").write_text(yaml.safe_dump({"groups": [{"name": "board", "rules": rules}]}))
    for words in (
        ("check", "config", "prometheus.yml"),
        ("test", "rules", "alerts_test.yml"),
        ("check", "rules", str(tmp_path / "board.yml")),
    ):
        done = subprocess.run(["promtool", *words], cwd=PROMETHEUS, capture_output=True, text=True)  # noqa: S607
        assert done.returncode == 0, done.stdout + done.stderr
