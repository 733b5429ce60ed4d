"""The example dashboard and alert rules fit the metrics of a running daemon."""

from __future__ import annotations

import json
import re
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from cameras.test_daemon import Cell
from grafana_foundation_sdk.cog import plugins
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.models.dashboard import Dashboard
from helpers.ports import free_port
from helpers.waiting import wait_until
from prometheus_client.parser import text_string_to_metric_families

CONFIG = Path(__file__).parent.parent.parent / "config"
DASHBOARD = json.loads((CONFIG / "grafana-dashboard.json").read_text())
FLEET = json.loads((CONFIG / "grafana-fleet.json").read_text())
RULES = yaml.safe_load((CONFIG / "prometheus-alerts.yml").read_text())["groups"][0]["rules"]
EXPRESSIONS = [target["expr"] for panel in DASHBOARD["panels"] for target in panel["targets"]]
OF_FLEET = [target["expr"] for panel in FLEET["panels"] for target in panel["targets"]]
EXPRESSIONS += [rule["expr"] for rule in RULES]


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, set[str]]]:
    """The names of all samples at /metrics of a cell with every part, with their labels."""
    folder = tmp_path_factory.mktemp("cell")
    cell = Cell(folder, 'source = "virtual-inprocess"')
    port = free_port()
    more = f'\n[web]\nport = {port}\n[recorder]\nfolder = "recordings"\nmin_free_mib = 0\n'
    more += '[history]\nfolder = "history"\nmin_free_mib = 0\n'
    cell.config.write_text(cell.config.read_text() + more)

    def samples() -> dict[str, set[str]]:
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=5) as answer:
                text = answer.read().decode()
        except OSError:  # Modbus answers already, the page not yet; on a busy machine too slowly
            return {}
        found: dict[str, set[str]] = {}
        for family in text_string_to_metric_families(text):
            for sample in family.samples:
                found.setdefault(sample.name, set()).update(sample.labels)
        return found

    try:
        cell.start()
        yield wait_until(lambda: found if "edged_sigma_meters" in (found := samples()) else None)
    finally:
        cell.stop()


def lost(written: Any, read: Any, place: str) -> list[str]:
    """The places of what was written and is not read, or otherwise."""
    if isinstance(written, dict) and isinstance(read, dict):
        return [found for key in written for found in lost(written[key], read.get(key), f"{place}.{key}")]
    if isinstance(written, list) and isinstance(read, list) and len(written) == len(read):
        pairs = enumerate(zip(written, read, strict=True))
        return [found for k, (was, is_now) in pairs for found in lost(was, is_now, f"{place}.{k}")]
    return [] if written == read else [place]


@pytest.mark.parametrize("board", [DASHBOARD, FLEET], ids=["cell", "fleet"])
def test_what_the_makers_of_grafana_call_a_dashboard_has_every_field(board: dict[str, Any]) -> None:
    """Grafana ignores a field that it does not know; its makers' library then loses it, too."""
    plugins.register_default_plugins()
    misspelt = {**board, "refesh": "1m"}
    for source, missing in ((board, []), (misspelt, [".refesh"])):
        read = json.loads(JSONEncoder().encode(Dashboard.from_json(source)))
        assert missing == lost(source, read, "")


def used(expression: str) -> dict[str, set[str]]:
    """The names of the metrics in a PromQL expression, with their labels."""
    found: dict[str, set[str]] = {}
    for name, chosen in re.findall(r"\b((?:edged|process)_\w+)(\{[^}]*\})?", expression):
        found.setdefault(name, set()).update(re.findall(r"(\w+)\s*(?:=~|!~|!=|=)", chosen))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("expression", [*EXPRESSIONS, *OF_FLEET])
def test_every_figure_that_is_shown_or_watched_exists(expression: str, served: dict[str, set[str]]) -> None:
    """Every metric and label of an expression exists at /metrics."""
    names = used(expression)
    assert names, expression
    assert names.keys() <= served.keys()
    grouped = {label for labels in re.findall(r"by \(([^)]*)\)", expression) for label in labels.split(", ")}
    for name, labels in names.items():
        # Prometheus adds `instance` and `job` when it scrapes, that of a plant its own label
        assert labels | grouped <= served[name] | {"instance", "job", "plant"}, name


@pytest.mark.slow
def test_the_dashboard_misses_nothing_that_an_operator_needs(served: dict[str, set[str]]) -> None:
    """Every metric of edged has a panel, except `edged_recordings`."""
    shown = {name for expression in EXPRESSIONS for name in used(expression)}
    shown |= {name.replace("_bucket", part) for name in shown for part in ("_sum", "_count", "_created")}
    shown |= {name.replace("_total", "_created") for name in shown}
    own = {name for name in served if name.startswith("edged_")}
    assert {"edged_recordings"} == own - shown


@pytest.mark.parametrize("dashboard", [DASHBOARD, FLEET], ids=["cells", "fleet"])
def test_the_dashboard_can_be_imported_anywhere(dashboard: dict[str, Any]) -> None:
    """The dashboard has no data source of its own, and its panels are numbered, described and do not
    overlap."""
    panels = dashboard["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels)
    places = [
        (x, y)
        for at in (panel["gridPos"] for panel in panels)
        for x in range(at["x"], at["x"] + at["w"])
        for y in range(at["y"], at["y"] + at["h"])
    ]
    assert len(set(places)) == len(places)
    assert max(x for x, _ in places) < 24
    assert all(panel["description"] and panel["fieldConfig"]["defaults"]["unit"] for panel in panels)
    sources = re.findall(r'"uid": "([^"]*)"', json.dumps(panels))
    assert {"${datasource}"} == set(sources)


@pytest.mark.parametrize("dashboard", [DASHBOARD, FLEET], ids=["cells", "fleet"])
def test_a_figure_of_now_is_of_now(dashboard: dict[str, Any]) -> None:
    """Of a range, Grafana shows the last value: a cell that is gone, but was ready hours ago, as ready."""
    now = [panel for panel in dashboard["panels"] if panel["type"] != "timeseries"]
    assert now
    assert all(target.get("instant") for panel in now for target in panel["targets"])


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule["alert"])
def test_every_alarm_says_where_and_what(rule: dict[str, object]) -> None:
    """Every alarm has a summary with the instance, and is described in docs/how-to/operate.md."""
    summary = rule["annotations"]["summary"]
    assert summary.startswith("{{ $labels.instance }}: ")
    assert str(rule["alert"]) in (CONFIG.parent / "docs" / "how-to" / "operate.md").read_text()
