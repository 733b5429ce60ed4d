"""A pytest plugin: marks tests whose time limits a busy machine cannot keep with `alone`.

`tools/test` runs them after all others, in a process of their own.
"""

from __future__ import annotations

from fnmatch import fnmatchcase

import pytest

REASONS = {
    "tests/cameras/test_camera_faults.py::test_packets_that_are_lost_and_*": "0.2 s: Aravis waits no longer",
    "tests/cameras/test_camera_modes.py::test_a_scheduled_action_*": "0.4 s until both expose",
    "tests/wire/test_opcua_hostile.py::test_ten_thousand_*": "a good client waits for 5 s at most",
    "tests/wire/test_floods.py::*": "a PLC is answered within 5 s beside what floods the cell",
}
"""Test ids (shell patterns), each with the time limit that makes it sensitive."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Add the marker to the tests listed in `REASONS`."""
    for item in items:
        for test, reason in REASONS.items():
            if fnmatchcase(item.nodeid, test):
                item.add_marker(pytest.mark.alone(reason))
