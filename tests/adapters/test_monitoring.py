"""A plant's real Prometheus and Alertmanager beside a real daemon."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from argon2 import PasswordHasher
from helpers.prometheus import CONFIG, Engine, plant_config, program
from helpers.smallcell import SmallCell
from helpers.waiting import LIMIT_S, wait_until

TOKEN = "a token of the plant"
AT_REST = {"Faults of the cameras", "Why targets were refused"}
"""Panels that are empty while nothing is wrong."""
TEMPLATE = Path("/usr/share/prometheus/alertmanager/default.tmpl")
"""Debian's Alertmanager does not start without it."""
ARE_HERE = program("prometheus") and program("prometheus-alertmanager") and TEMPLATE.exists()
pytestmark = [pytest.mark.long, pytest.mark.skipif(not ARE_HERE, reason="no prometheus")]


@dataclass
class Plant:
    """A daemon and its monitoring. central : receives what the plant's Prometheus writes."""

    cell: SmallCell
    daemon: subprocess.Popen[bytes]
    own: Engine
    central: Engine
    alertmanager: Engine


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    """The started plant; the cell has a password, and Prometheus the token of /metrics."""
    folder = tmp_path_factory.mktemp("plant")
    cell = SmallCell(folder / "cell", period_s=0.2, recordings=folder / "recordings")
    hashed = PasswordHasher(time_cost=1, memory_cost=512, parallelism=1).hash(TOKEN)
    text = cell.config.read_text().replace("[web]", f'[web]\nmetrics_password_hash = "{hashed}"')
    text += f'[history]\nfolder = "{folder / "history"}"\nplant = "north"\nmin_free_mib = 0\n'
    cell.config.write_text(text)
    places = [folder / name for name in ("own", "central", "alertmanager")]
    for place in places:
        place.mkdir()
    (places[1] / "prometheus.yml").write_text("{}")
    (places[2] / "alertmanager.yml").write_text("route: {receiver: shift}\nreceivers: [{name: shift}]\n")
    central = Engine(
        "prometheus", places[1], "--config.file=prometheus.yml", "--web.enable-remote-write-receiver"
    )
    alertmanager = Engine(
        "prometheus-alertmanager", places[2], "--config.file=alertmanager.yml", "--cluster.listen-address="
    )
    targets = [f"127.0.0.1:{cell.web_port}"]
    config = plant_config(
        places[0], targets, token=TOKEN, alerts_to=alertmanager.port, writes_to=central.port
    )
    rules = config.with_name("prometheus-alerts.yml")
    rules.write_text(rules.read_text().replace("for: 2m", "for: 2s"))
    own = Engine("prometheus", places[0], f"--config.file={config}")
    engines = own, central, alertmanager
    with (folder / "log").open("wb") as log:
        daemon = subprocess.Popen([sys.executable, "-m", "edged", "run", str(cell.config)], stderr=log)
    try:
        for engine in engines:
            engine.start()
        wait_until(lambda: own.query('increase(edged_cycles_total{status="OK"}[30s]) > 3'))
        yield Plant(cell, daemon, own, central, alertmanager)
    finally:
        daemon.kill()
        daemon.wait(LIMIT_S)
        for engine in engines:
            engine.kill()


@pytest.mark.parametrize(
    ("name", "which"), [("grafana-dashboard.json", "own"), ("grafana-fleet.json", "central")]
)
def test_every_panel_has_figures_of_a_cell_that_measures(plant: Plant, name: str, which: str) -> None:
    """Every panel gets figures, the fleet's by remote write with the label of the plant."""
    engine: Engine = getattr(plant, which)
    for panel in json.loads((CONFIG / name).read_text())["panels"]:
        for target in panel["targets"]:
            question = re.sub(r"\$\w+", ".*", target["expr"])
            if panel["title"] in AT_REST:
                assert not engine.query(question), panel["title"]
                continue
            wait_until(lambda asked=question: _numbers(engine, asked))


def _numbers(engine: Engine, question: str) -> bool:
    """Whether the answer has values, all of them numbers."""
    values = [float(row["value"][1]) for row in engine.query(question)]
    return bool(values) and not any(map(math.isnan, values))


def test_a_cell_that_dies_is_told_to_the_alertmanager_and_nothing_else_is(plant: Plant) -> None:
    """A killed cell raises `EdgedGone`, with cell and plant, and no other alarm; the rule's 2 minutes are
    2 seconds here. The dashboard shows it gone."""

    def alerts() -> set[str]:
        return {alert["labels"]["alertname"] for alert in plant.alertmanager.asked("/api/v2/alerts")}

    wait_until(lambda: plant.own.asked("/api/v1/alertmanagers")["data"]["activeAlertmanagers"])
    assert set() == alerts()
    plant.daemon.kill()
    wait_until(alerts)
    assert {"EdgedGone"} == alerts()
    (alert,) = plant.alertmanager.asked("/api/v2/alerts")
    instance = f"127.0.0.1:{plant.cell.web_port}"
    assert (instance, "north") == (alert["labels"]["instance"], alert["labels"]["plant"])
    assert f"{instance}: the cell no longer answers" == alert["annotations"]["summary"]
    ready = json.loads((CONFIG / "grafana-dashboard.json").read_text())["panels"][0]
    assert (-1.0, "GONE") == _shown(plant.own, ready)


def _shown(engine: Engine, panel: dict[str, Any]) -> tuple[float, str]:
    """The only value of a panel, and the word that stands for it."""
    (row,) = engine.query(re.sub(r"\$\w+", ".*", panel["targets"][0]["expr"]))
    value = float(row["value"][1])
    return value, panel["fieldConfig"]["defaults"]["mappings"][0]["options"][f"{value:g}"]["text"]
