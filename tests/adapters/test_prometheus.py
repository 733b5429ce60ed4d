"""The files for Prometheus and Grafana, checked by Prometheus' own promtool."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parent.parent.parent
CONFIG = ROOT / "config"
RULES = CONFIG / "prometheus-alerts.yml"
UNITS = yaml.safe_load((ROOT / "tests" / "data" / "prometheus-alerts.test.yml").read_text())
ALERTS = {
    rule["alert"]: rule["annotations"]["summary"]
    for rule in yaml.safe_load(RULES.read_text())["groups"][0]["rules"]
}
PROMTOOL = shutil.which("promtool", path=f"{Path(sys.executable).parent}:{os.environ['PATH']}") or ""
pytestmark = pytest.mark.skipif(not PROMTOOL, reason="no promtool")


def judged(*arguments: object) -> str:
    """The output of promtool; fails unless everything is well."""
    ended = subprocess.run([PROMTOOL, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert 0 == ended.returncode, ended.stdout + ended.stderr
    return ended.stdout


def unit_tests(folder: Path, rules: str) -> Path:
    """A test file for promtool that asks for every alarm at each time and expects only the named ones."""
    (folder / "rules.yml").write_text(rules)
    tests: list[dict[str, Any]] = []
    for unit in UNITS["tests"]:
        asked = []
        for at in unit["alert_rule_test"]:
            for name, summary in ALERTS.items():
                said = {"summary": summary.replace("{{ $labels.instance }}", "a")}
                there = [{"exp_labels": {"instance": "a"}, "exp_annotations": said}]
                expected = there if name in at.get("alerts", []) else []
                asked.append({"eval_time": at["eval_time"], "alertname": name, "exp_alerts": expected})
        tests.append({**unit, "alert_rule_test": asked})
    file = folder / "tests.yml"
    file.write_text(json.dumps({**UNITS, "rule_files": ["rules.yml"], "tests": tests}))
    return file


def test_each_alarm_comes_when_it_should_and_no_other(tmp_path: Path) -> None:
    """There is a case for every alarm in which it fires, and no other."""
    assert "SUCCESS" in judged("test", "rules", unit_tests(tmp_path, RULES.read_text()))
    times = [at for unit in UNITS["tests"] for at in unit["alert_rule_test"]]
    fired = {name for at in times for name in at.get("alerts", [])}
    assert ALERTS.keys() == fired


@pytest.mark.long
@pytest.mark.parametrize(
    ("rule", "other"),
    [
        ("edged_ready == 0 unless edged_setup == 1", "edged_ready == 0"),
        ("last_over_time(edged_ready[1d]) unless edged_ready", "edged_ready == 2"),
        ("> 0.1 * sum", "> 0.01 * sum"),
        ("for: 12h", "for: 1h"),
        ("histogram_quantile(0.99,", "histogram_quantile(0.9,"),
    ],
)
def test_another_rule_would_be_noticed(rule: str, other: str, tmp_path: Path) -> None:
    """A changed rule fails these cases."""
    text = RULES.read_text()
    assert rule in text
    with pytest.raises(AssertionError, match="FAILED"):
        judged("test", "rules", unit_tests(tmp_path, text.replace(rule, other)))


def test_the_example_of_a_plant_is_a_configuration(tmp_path: Path) -> None:
    """The example configuration passes `promtool check config`, with its rules."""
    for name in ("prometheus-plant.yml", "prometheus-alerts.yml"):
        shutil.copy(CONFIG / name, tmp_path)
    told = judged("check", "config", tmp_path / "prometheus-plant.yml")
    assert f"{len(ALERTS)} rules found" in told
    assert "SUCCESS" in told


@pytest.mark.parametrize("name", ["grafana-dashboard.json", "grafana-fleet.json"])
def test_every_panel_asks_what_prometheus_understands(name: str, tmp_path: Path) -> None:
    """Each query of a panel is valid, with Grafana's variables filled in."""
    panels = json.loads((CONFIG / name).read_text())["panels"]
    questions = [target["expr"] for panel in panels for target in panel["targets"]]
    rules = [
        {"record": f"q{number}", "expr": re.sub(r"\$\w+", ".*", question)}
        for number, question in enumerate(questions)
    ]
    file = tmp_path / "rules.yml"
    file.write_text(json.dumps({"groups": [{"name": "panels", "rules": rules}]}))
    assert f"{len(questions)} rules found" in judged("check", "rules", file)


def test_the_fleet_names_the_plant_whose_cells_are_gone_and_the_cell_that_differs(tmp_path: Path) -> None:
    """The fleet's queries name the plant with missing cells and the cell that differs, for figures of two
    plants."""
    fleet = json.loads((CONFIG / "grafana-fleet.json").read_text())
    panels = {panel["title"]: panel for panel in fleet["panels"]}
    series, values = [], {"a": 1.0, "b": 1.1, "c": 4.0}
    for plant in ("north", "south"):
        for cell, factor in values.items():
            labels = f'plant="{plant}", instance="{plant}-{cell}"'
            is_gone = (plant, cell) == ("south", "a")
            series += [
                (f"edged_ready{{{labels}}}", "1x10 stale" if is_gone else "1x20"),
                (f"edged_setup{{{labels}}}", "0x20"),
                (f"edged_rows_mean_pixels{{{labels}}}", f"{0.1 * factor if plant == 'north' else 0.1}x20"),
            ]

    def asked(title: str, *samples: tuple[str, float]) -> dict[str, Any]:
        expression = panels[title]["targets"][0]["expr"].replace("$plant", ".*")
        return {
            "expr": expression,
            "eval_time": "15m",
            "exp_samples": [{"labels": labels, "value": value} for labels, value in samples],
        }

    file = tmp_path / "tests.yml"
    tests = [
        asked("Cells", ('{plant="north"}', 3), ('{plant="south"}', 2)),
        asked("Gone", ('{plant="north"}', 0), ('{plant="south"}', 1)),
        asked("Not ready", ('{plant="north"}', 0), ('{plant="south"}', 0)),
    ]
    inputs = [{"series": name, "values": points} for name, points in series]
    file.write_text(
        json.dumps({"tests": [{"interval": "1m", "input_series": inputs, "promql_expr_test": tests}]})
    )
    assert "SUCCESS" in judged("test", "rules", file)
    ratio = panels["Row difference against the plant's median"]["targets"][0]["expr"].replace("$plant", ".*")
    highest = {**asked("Cells"), "expr": f"topk(1, {ratio}) > bool 3.6"}
    highest["exp_samples"] = [{"labels": '{plant="north", instance="north-c"}', "value": 1}]
    file.write_text(
        json.dumps({"tests": [{"interval": "1m", "input_series": inputs, "promql_expr_test": [highest]}]})
    )
    assert "SUCCESS" in judged("test", "rules", file)
