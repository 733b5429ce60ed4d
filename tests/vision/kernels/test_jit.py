"""Kernels from the disk cache: the same machine code, loaded without the work of a compilation."""

from __future__ import annotations

import itertools
import json
import os
import pickle
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, cast

import numba
import numpy as np
import pytest

from edged.vision.kernels import jit, jitcache
from edged.vision.kernels.jit import F1, INT, kernel, load_all, load_called
from edged.vision.kernels.jitcache import StoredIndex, frozen_into, take_over


class Ends(NamedTuple):
    """The first and the last of some values."""

    both: F1


class Found(NamedTuple):
    """How many values there are, and their ends if there are any."""

    count: INT
    ends: Ends | None


@kernel("Found(f8[::1])", tuples=(Ends, Found))
def found_in(values: Any) -> Found:
    """A tuple with a field that may be None."""
    ends = None
    if len(values) > 0:
        ends = Ends(np.array([values[0], values[-1]]))
    return Found(len(values), ends)


def test_a_field_of_a_tuple_may_be_none() -> None:
    """An annotation with None is an optional field: None stays None, and a tuple keeps its arrays."""
    assert (0, None) == found_in(np.zeros(0))
    found = found_in(np.arange(3.0))
    assert (3, Ends) == (found.count, type(found.ends))
    assert [0.0, 2.0] == found.ends.both.tolist()


STORED = """
import numpy as np
from edged.vision.kernels import jit, jitcache
from edged.vision.kernels.jit import kernel

@kernel("f8[::1](f8[::1], f8)")
def scaled(values, factor):
    out = np.empty(values.size)
    for i in range(values.size):
        out[i] = values[i] * factor
    return out
"""
RUN = """
import json
import llvmlite.binding as llvm
import numba
import numpy as np

parse, parsed = llvm.parse_bitcode, []

def counted(bitcode, *rest):
    parsed.append(len(bitcode))
    return parse(bitcode, *rest)

llvm.parse_bitcode = counted
from stored import scaled

values = np.array([1.0, 2.0, 4.5])
found = {"scaled": scaled(values, 3.0).tolist(), "hits": sum(scaled.stats.cache_hits.values())}
found["parsed"] = len(parsed)

@numba.njit("f8(f8[::1], f8)")  # never stored
def total(values, factor):
    result = 0.0
    for value in scaled(values, factor):
        result += value
    return result

found["total"], found["parsed for another"] = total(values, 2.0), len(parsed)
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """The findings of two processes that run a kernel and then compile another one that calls it."""
    folder = tmp_path_factory.mktemp("kernels")
    (folder / "stored.py").write_text(STORED)
    (folder / "run.py").write_text(RUN)
    outputs = [
        subprocess.run([sys.executable, folder / "run.py"], capture_output=True, text=True, check=True)
        for _ in range(2)
    ]
    return [{**json.loads(output.stdout), "told": output.stderr} for output in outputs]


@pytest.mark.slow
def test_whoever_waits_for_the_compiler_is_told_so_once(runs: list[dict[str, Any]]) -> None:
    """The process that compiles says so once on standard error; one that loads from the cache says
    nothing."""
    said = [found["told"] for found in runs]
    assert ["compiling numerical kernels (once, up to three minutes)\n", ""] == said


@pytest.mark.slow
def test_without_a_place_to_store_kernels_it_is_said_too(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Without a usable cache each start compiles, and says so."""
    monkeypatch.setattr(jit, "_cache_is_usable", lambda: False)
    monkeypatch.setattr(jitcache, "_said", itertools.count())

    @kernel("f8(f8)")
    def doubled(value: float) -> float:
        return 2.0 * value

    assert 3.0 == doubled(1.5)
    assert ["compiling numerical kernels (once, up to three minutes)"] == caplog.messages


@pytest.mark.slow
def test_a_stored_kernel_is_what_was_compiled(runs: list[dict[str, Any]]) -> None:
    """The first process compiles, the second takes it from the cache, and both allocate and fill an array."""
    assert [0, 1] == [found["hits"] for found in runs]
    assert [[3.0, 6.0, 13.5]] * 2 == [found["scaled"] for found in runs]


@pytest.mark.slow
def test_bitcode_waits_until_another_kernel_needs_it(runs: list[dict[str, Any]]) -> None:
    """A stored kernel runs without parsing its bitcode; a later compiled kernel that calls it parses it
    once."""
    assert (0, 1) == (runs[1]["parsed"], runs[1]["parsed for another"])
    assert [15.0, 15.0] == [found["total"] for found in runs]


def test_a_kernel_takes_only_what_it_was_declared_for() -> None:
    """Another type is an error, not a second compilation in the middle of a cycle."""

    @kernel("f8(f8[::1])")
    def first(values: Any) -> Any:
        return values[0]

    with pytest.raises(TypeError, match="No matching definition"):
        first(np.ones(2, np.float32))


def test_a_kernel_is_loaded_with_its_first_call() -> None:
    """A kernel without a call is not loaded; its first call loads it."""

    @kernel("f8(f8)")
    def doubled(value: Any) -> Any:
        return 2 * value

    assert () == tuple(doubled.signatures)
    assert 6.0 == doubled(3.0)
    assert 1 == len(doubled.signatures)


def test_a_kernel_that_another_calls_keeps_its_declared_types() -> None:
    """A kernel that another one calls is compiled as declared, and not again for the caller's types."""

    @kernel("f8(f8[:])")
    def first(values: Any) -> Any:
        return values[0]

    @kernel("f8(f8[::1])")
    def twice(values: Any) -> Any:
        return first(values) + first(values)

    assert 6.0 == twice(np.array([3.0]))
    assert 1 == len(first.signatures)


FACTOR = 2.0


@kernel("f8(f8)")
def _times_factor(value: float) -> float:
    return FACTOR * value


@kernel("f8(f8)")
def _and_one(value: float) -> float:
    return _times_factor(value) + 1.0


def test_a_stored_kernel_is_known_by_the_numbers_frozen_into_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A changed constant, also in a called kernel, changes the stored kernel's key."""
    before = frozen_into(cast(Any, _and_one).py_func)
    monkeypatch.setitem(globals(), "FACTOR", 3.0)

    assert "'FACTOR'), '2.0'" in before
    assert before != frozen_into(cast(Any, _and_one).py_func)


@pytest.mark.long
def test_a_stored_kernel_is_known_by_the_code_of_those_it_calls(tmp_path: Path) -> None:
    """A changed file with a called kernel compiles the callers in other files anew."""
    kernel_of = (
        "from edged.vision.kernels.jit import kernel\n{}\n@kernel('f8(f8)')\ndef {}(x):\n    return {}\n"
    )
    (tmp_path / "caller.py").write_text(
        kernel_of.format("from called import called", "caller", "called(x) + 1.0")
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    said = []
    for what in ("2.0 * x", "x * 2.0 * x"):
        (tmp_path / "called.py").write_text(kernel_of.format("", "called", what))
        call = [sys.executable, "-c", "from caller import caller; print(caller(5.0))"]
        ran = subprocess.run(call, env=environment, capture_output=True, text=True, check=True)
        said.append(ran.stdout.strip())
    assert said == ["11.0", "51.0"]


def test_what_was_stored_for_a_renamed_class_is_compiled_anew(tmp_path: Path) -> None:
    """A stored index with a class that no longer exists counts as empty."""
    renamed = b"cedged.vision.kernels.jit\nNameBefore\n."
    (tmp_path / "kernel.nbi").write_bytes(pickle.dumps(numba.__version__) + renamed)

    assert StoredIndex(str(tmp_path), "kernel", "stamp").load("signature") is None


def test_threads_may_call_a_kernel_first() -> None:
    """Threads that call a kernel at the same time all get the result, and it is loaded once."""

    @kernel("f8(f8[::1])")
    def total(values: Any) -> Any:
        result = 0.0
        for value in values:
            result += value
        return result

    together = threading.Barrier(4)

    def call(_turn: int) -> float:
        together.wait()
        return float(total(np.ones(5)))

    with ThreadPoolExecutor(4) as threads:
        assert [5.0] * 4 == list(threads.map(call, range(4)))
    assert 1 == len(total.signatures)


def test_only_what_python_calls_is_loaded_ahead() -> None:
    """Only kernels that Python calls are loaded ahead; those that only kernels call are not."""
    module = ModuleType("rooms.one")
    program = """
from functools import cache
from edged.vision.kernels import jit, jitcache
from edged.vision.kernels.jit import kernel

@kernel("f8(f8)")
def inner(value):
    return value + 1.0

@kernel("f8(f8)")
def unused(value):
    return inner(value)

@kernel("f8(f8)")
def outer(value):
    return value - 1.0

class Caller:
    @staticmethod
    @cache
    def call(value):
        return [outer(one) for one in (value,)]
"""
    exec(compile(program, __file__, "exec"), vars(module))
    sys.modules[module.__name__] = module
    try:
        load_called("rooms")
        kernels = (module.inner, module.unused, module.outer)
        assert [0, 0, 1] == [len(one.signatures) for one in kernels]
        load_all(module)
        assert [1, 1, 1] == [len(one.signatures) for one in kernels]
    finally:
        del sys.modules[module.__name__]


SOURCE = """
from edged.vision.kernels.jit import kernel
@kernel("f8(f8)")
def twice(x):
    return 2.0 * x
"""


@pytest.mark.long
def test_kernels_of_sources_in_another_folder_are_taken_over_and_found_by_a_link(tmp_path: Path) -> None:
    """Kernels of the same sources in another folder are taken over, and a link to the folder finds them."""
    before, after, current, kernels = (tmp_path / name for name in ("before", "after", "current", "kernels"))
    for place in (before, after):
        (place / "edged").mkdir(parents=True)
        (place / "edged" / "some.py").write_text(SOURCE)
    current.symlink_to(after)
    said = []
    for place in (before, current):
        run = f"import sys; sys.path.insert(0, '{place}/edged'); import some; some.twice(1.0)"
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(kernels / place.name)}
        call = [sys.executable, "-c", run]
        done = subprocess.run(call, env=environment, capture_output=True, text=True, check=True)
        said.append("compiling" in done.stderr)
        take_over(kernels / "before", before, kernels / "current", after)
    assert [True, False] == said
