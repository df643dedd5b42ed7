"""Alert rules and dashboard: all that they use is exported by the server, and all that it exports is shown."""

import json
import re
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest
from prometheus_client.parser import text_string_to_metric_families

from recording.clock import mono_ns
from server.api.panel_alarm_catalogue import CATALOGUE
from server.inner_faults import SERVER_PART_FAILED_FAULT_ID
from server.jobs.engine import JobState

DEPLOY = Path(__file__).parents[3] / "docs" / "deploy"
RULES, BOARD = DEPLOY / "alerts.yml", DEPLOY / "grafana.json"
METRIC = re.compile(r"\b((?:longreach|process)_\w+)(?:\{([^}]*)\})?")
MATCHER = re.compile(r'(\w+)=~?"([^"]*)"')
OF_PROMETHEUS = {"job", "instance"}  # labels that the scrape adds


def rule_expressions():
    return re.findall(r"^ +expr: (.+)$", RULES.read_text(encoding="utf-8"), re.MULTILINE)


def board_expressions():
    panels = json.loads(BOARD.read_text(encoding="utf-8"))["panels"]
    return [target["expr"] for panel in panels for target in panel["targets"]]


@pytest.fixture
async def exported(open_bench):
    """Label values of each metric of a server with a camera, a job that has ended, an alarm and a fault."""
    open_bench.service.inner_faults.watch(SERVER_PART_FAILED_FAULT_ID, lambda: "a part of the server has failed")
    open_bench.service.cell.vision.latest = SimpleNamespace(fps=15.0, t_receive_mono_ns=mono_ns(), process_ms=20.0)
    async with open_bench.client() as client:
        await client.post("/v1/jobs", json={"kind": "park"}, headers=open_bench.control())
        await open_bench.settled()
        text = (await client.get("/metrics")).text
    found = {}
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            values = found.setdefault(sample.name, {})
            for label, value in sample.labels.items():
                values.setdefault(label, set()).add(value)
    found["longreach_jobs_ended_total"]["state"] |= {state.value for state in JobState}
    return found


async def test_rules_and_dashboard_use_what_the_server_exports(exported):
    assert len(rule_expressions()) == RULES.read_text(encoding="utf-8").count("- alert:") > 10
    assert len(board_expressions()) > 20
    for expression in [*rule_expressions(), *board_expressions()]:
        used = METRIC.findall(expression)
        assert used or expression.startswith("up{"), expression
        for name, matchers in used:
            assert name in exported, f"{expression}: no metric {name}"
            for label, value in MATCHER.findall(matchers):
                if label not in OF_PROMETHEUS:
                    assert value in exported[name][label], f"{expression}: no {label}={value}"


async def test_every_metric_of_the_server_is_on_the_dashboard(exported):
    shown = {name for expression in board_expressions() for name, _ in METRIC.findall(expression)}
    ours = {name for name in exported if name.startswith("longreach_") and not name.endswith("_created")}
    assert ours - shown == set()


def test_a_rule_of_an_alarm_names_a_priority_of_the_catalogue():
    named = set(re.findall(r'priority="(\w+)"', RULES.read_text(encoding="utf-8")))
    assert named
    assert named <= {kind.level for kind in CATALOGUE.values()}


@pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool is not installed: Debian's package prometheus")
def test_promtool_accepts_the_rules():
    done = subprocess.run(["promtool", "check", "rules", str(RULES)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
