"""A pytest plugin: lists which tests may be skipped, and why; other skips are shown, and fail if CI=true."""

from __future__ import annotations

import os
import re
from fnmatch import fnmatchcase

import pytest

ALLOWED = {
    "tests/adapters/test_monitoring.py::*": "no prometheus",
    "tests/adapters/test_prometheus.py::*": "no promtool",
    "tests/commands/test_as_root.py::*": "only root",
    "tests/commands/test_doctor.py::test_without_the_right_*": "not root",
    "tests/system/test_*.py::*": "not root|not allowed here|cannot be mounted|this kernel",
    "tests/tools/test_photoworld.py::*": "could not import 'mitsuba'",
    "tests/tools/test_vendor.py::test_the_same_versions_*": "no npm|npm reaches no packages",
    "tests/wire/test_browser.py::*": "no chromium",
    "tests/cameras/test_setup_page_cameras.py::*": "no chromium",
    "tests/wire/test_setup_page*.py::*": "no chromium|no firefox|no webkit",
    "tests/cameras/test_doctor_networks.py::*": "not root|this kernel",
    "tests/wire/test_robot_examples.py::*yaskawa*": "no C compiler",
    "tests/wire/test_robot_languages.py::*Yaskawa*": "no C compiler",
    "tests/wire/test_service.py::test_a_bad_disk_*": "this kernel",
}
"""Test ids (shell patterns), each with the skip reasons that cannot be avoided here (regular expressions)."""

UNEXPECTED = 7
"""Exit code of a run in which a test was skipped that must not be, with CI=true. Not pytest's own for failed
tests, after which these alone are run again."""


def pytest_configure(config: pytest.Config) -> None:
    """Register where the reports of all processes arrive."""
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(Skips())


class Skips:
    """The skips of a run that are not `ALLOWED`."""

    def __init__(self) -> None:
        self.unexpected: dict[str, str] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a test that was skipped."""
        self._note(report)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Note a whole module that was skipped."""
        self._note(report)

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fail the run on unexpected skips if CI=true."""
        strict = os.environ.get("CI") == "true"
        ended = session.exitstatus in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED)
        if strict and self.unexpected and ended:
            session.exitstatus = UNEXPECTED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Show tests that were skipped although tools/test installs all that they need."""
        if self.unexpected:
            terminalreporter.section("skipped, and not on the list of tests/helpers/skips.py", red=True)
            for test, reason in self.unexpected.items():
                terminalreporter.write_line(f"{test}: {reason}")

    def _note(self, report: pytest.TestReport | pytest.CollectReport) -> None:
        if not report.skipped or hasattr(report, "wasxfail"):
            return
        assert isinstance(report.longrepr, tuple)
        reason = str(report.longrepr[2]).removeprefix("Skipped: ")
        allowed = (reasons for test, reasons in ALLOWED.items() if fnmatchcase(report.nodeid, test))
        if not any(re.search(reasons, reason) for reasons in allowed):
            self.unexpected[report.nodeid] = reason
