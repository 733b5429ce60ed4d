"""Conditions of all tests: one BLAS thread, no deadlines, and tests that never run together or may be
skipped.

pytest makes `helpers` and `naive` importable from every test.
"""

import copy
import gc
import hashlib
import os
import shutil
import sys
from collections import Counter

import pytest
from hypothesis import settings
from xdist.scheduler import LoadScopeScheduling

# as `edged` itself does: BLAS threads on small matrices only spin; set before anything imports numpy
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

settings.register_profile("edged", deadline=None)  # an example takes what a busy machine leaves it
settings.load_profile("edged")

pytest_plugins = ["helpers.alone", "helpers.coroutines", "helpers.skips"]

ONE_WIRE = (
    "tests/cameras/",
    "tests/commands/test_doctor.py",
    "tests/commands/test_grab.py",
    "tests/system/",
    "tests/tools/test_rerun.py",
)
"""Cameras at fixed addresses (GVCP has one port), broadcasts that all of them get, throwaway machines."""
NICE = 10


class ByFile(LoadScopeScheduling):
    """Each file of tests is for one process; all that share the cameras' network are for the same one."""

    def _split_scope(self, nodeid: str) -> str:
        return "cameras" if nodeid.startswith(ONE_WIRE) else nodeid.partition("::")[0]


@pytest.fixture(scope="session")
def template(tmp_path_factory):
    """The files of a complete cell, which no test changes."""
    from helpers.smallcell import SmallCell

    return SmallCell(tmp_path_factory.mktemp("template"), source="virtual-inprocess").config.parent


@pytest.fixture(scope="session", autouse=True)
def taught_once():
    """Teach the job of the demo's cells once for the same pictures, which takes up to three seconds."""
    demo = sys.modules.get("edged.commands.demo")  # to import it here takes two seconds
    if demo is None:
        yield
        return
    learn, jobs = demo.teach, {}

    def teach(left, right, rectification, region, name):
        key = repr(rectification.rig), region, name, left.tobytes(), right.tobytes()
        if key not in jobs:
            jobs[key] = learn(left, right, rectification, region, name)
        return jobs[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo, "teach", teach)
        yield


@pytest.fixture(scope="session", autouse=True)
def boards_seen_once():
    """Detect a board in a picture once: many tests begin with the same pictures, 0.2 s for each."""
    detection = sys.modules.get("edged.vision.boards.detection")
    if detection is None:
        yield
        return
    kinds = "chessboard", "charuco", "dots"
    with pytest.MonkeyPatch.context() as patch:
        for name in (*map("detect_{}".format, kinds), *map("recognise_{}".format, kinds)):
            patch.setattr(detection, name, _once(getattr(detection, name)))
        yield


def _once(find):
    """The function with a cache that returns copies."""
    found = {}

    def once(image, *board):
        key = hashlib.sha256(image.tobytes()).digest(), image.shape, repr(board)
        if key not in found:
            found[key] = find(image, *board)
        return copy.deepcopy(found[key])

    return once


@pytest.fixture
def own_cell(template, tmp_path):
    """The files of a complete cell for one test."""
    return shutil.copytree(template, tmp_path / "cell")


def pytest_collection_finish():
    """Do not collect what was imported as garbage, which took a quarter of the servers' tests."""
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


def pytest_collection_modifyitems(items):
    """Run files with most slow tests first, so that no process waits at the end for another's long file."""
    slow = Counter(
        item.path for item in items if {"slow", "long"} & {mark.name for mark in item.iter_markers()}
    )
    items.sort(key=lambda item: (not item.nodeid.startswith(ONE_WIRE), -slow[item.path]))


def pytest_runtest_setup(item):
    """Let tests with cameras go first if tests run in parallel."""
    waits = "PYTEST_XDIST_WORKER" in os.environ and not item.nodeid.startswith(ONE_WIRE)
    if waits and os.getpriority(os.PRIO_PROCESS, 0) < NICE:
        os.nice(NICE)


def pytest_xdist_make_scheduler(config, log):
    """Share out the tests of `-n` in their order, not by the number of tests per file."""
    config.option.loadscopereorder = False
    return ByFile(config, log)


@pytest.hookimpl(wrapper=True)
def pytest_report_to_serializable():
    """Make messages between processes valid UTF-8, which the log of a damaged file may not be."""
    return _as_utf8((yield))


def _as_utf8(value):
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode()
    if isinstance(value, dict):
        return {key: _as_utf8(part) for key, part in value.items()}
    return type(value)(map(_as_utf8, value)) if isinstance(value, list | tuple) else value
