"""Prometheus and Alertmanager as Debian packages them, as separate processes, with the plant's example."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import urllib.parse
import urllib.request
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from helpers.ports import free_port
from helpers.waiting import LIMIT_S

CONFIG = Path(__file__).parents[2] / "config"
PLACES = f"{Path(sys.executable).parent}:{os.environ['PATH']}"


def program(name: str) -> str:
    """Path of a program; "" if it is not installed."""
    return shutil.which(name, path=PLACES) or ""


def plant_config(
    folder: Path,
    targets: Sequence[str],
    *,
    token: str = "",
    every: str = "1s",
    alerts_to: int | None = None,
    writes_to: int | None = None,
) -> Path:
    """`config/prometheus-plant.yml` with these cells, and its rules, whose durations stay as shipped.

    alerts_to, writes_to : ports of an Alertmanager, and of a Prometheus that accepts remote writes.
    """
    shutil.copy(CONFIG / "prometheus-alerts.yml", folder)
    config = yaml.safe_load((CONFIG / "prometheus-plant.yml").read_text())
    config["global"] |= {"scrape_interval": every, "evaluation_interval": every}
    cells = config["scrape_configs"][0]
    cells["static_configs"] = [{"targets": [*targets]}]
    if token:
        cells["authorization"] = {"credentials": token}
    write = config.pop("remote_write")[0]
    if writes_to is not None:
        config["remote_write"] = [{**write, "url": f"http://127.0.0.1:{writes_to}/api/v1/write"}]
    if alerts_to is not None:
        receivers = [{"targets": [f"127.0.0.1:{alerts_to}"]}]
        config["alerting"] = {"alertmanagers": [{"static_configs": receivers}]}
    file = folder / "prometheus.yml"
    file.write_text(yaml.safe_dump(config))
    return file


class Engine:
    """A server that can be killed and restarted on the data it has kept. options : of its command line."""

    def __init__(self, name: str, folder: Path, *options: str) -> None:
        self.port, self._folder = free_port(), folder
        data = {"prometheus": "--storage.tsdb.path", "prometheus-alertmanager": "--storage.path"}[name]
        self._command = [
            program(name),
            f"--web.listen-address=127.0.0.1:{self.port}",
            f"{data}={folder / name}",
        ]
        self._command += options
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start; it answers some time later."""
        with (self._folder / "log").open("ab") as log:
            self._process = subprocess.Popen(self._command, cwd=self._folder, stdout=log, stderr=log)

    def kill(self) -> None:
        """Kill it, as a power cut does."""
        if self._process is not None:
            self._process.kill()
            self._process.wait(LIMIT_S)
            self._process = None

    def asked(self, path: str, **arguments: str) -> Any:
        """Answer to a request, as JSON. Raises `OSError` while the server is not reachable."""
        question = urllib.parse.urlencode(arguments)
        with urllib.request.urlopen(f"http://127.0.0.1:{self.port}{path}?{question}", timeout=10) as answer:
            return json.load(answer)

    def query(self, expression: str) -> list[dict[str, Any]]:
        """Result of a PromQL query; only Prometheus answers this."""
        try:
            return list(self.asked("/api/v1/query", query=expression)["data"]["result"])
        except OSError:
            return []
