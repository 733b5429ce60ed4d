"""Compilation of kernels: for declared types, without the GIL, cached on disk, loaded on first use.

`for_both` runs the work for both cameras in parallel, in one further thread that its first use starts.
"""

from __future__ import annotations

import os
import re
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import CodeType, FunctionType, ModuleType, UnionType
from typing import Annotated, Any, TypeVar, cast, get_type_hints

import numba
import numpy as np
import numpy.typing as npt
from numba import types
from numba.core.dispatcher import Dispatcher
from numba.core.sigutils import normalize_signature

from edged.vision.kernels.jitcache import QuickCache, load_quickly, warn_compiling

F = TypeVar("F", bound=Callable[..., Any])
WRAPPED = ("__wrapped__", "__func__", "fget", "func")
"""Attributes in which a cache, a static method and two kinds of property keep their function."""
TYPE_NAME = re.compile(r"\w+(?:\[[^]]*\])?")
"""Matches a type within a signature, with its dimensions."""
Tuples = tuple[type[tuple[Any, ...]], ...]

load_quickly()


F1 = Annotated[npt.NDArray[np.float64], "f8[::1]"]
F2 = Annotated[npt.NDArray[np.float64], "f8[:, ::1]"]
F3 = Annotated[npt.NDArray[np.float64], "f8[:, :, ::1]"]
I1 = Annotated[npt.NDArray[np.int64], "i8[::1]"]
I2 = Annotated[npt.NDArray[np.int64], "i8[:, ::1]"]
B1 = Annotated[npt.NDArray[np.bool_], "b1[::1]"]
B2 = Annotated[npt.NDArray[np.bool_], "b1[:, ::1]"]
S2 = Annotated[npt.NDArray[np.int16], "i2[:, ::1]"]
G2 = Annotated[npt.NDArray[np.float32], "f4[:, ::1]"]
N2 = Annotated[npt.NDArray[np.int32], "i4[:, ::1]"]
INT = Annotated[int, "i8"]
FLOAT = Annotated[float, "f8"]
"""Types for fields of a `NamedTuple` argument of a kernel: contiguous arrays by dimensions, numbers."""


def kernel(
    *signatures: str,
    tuples: Tuples = (),
    inline: bool = False,
    any_order: bool = False,
) -> Callable[[F], F]:
    """Compile a plain-loop function to machine code.

    signatures : numba signatures, e.g. "f8(f4[:, ::1], f8, f8)"; no other is ever compiled. The code is
    loaded, or compiled if it is not stored, at the first call; `load_called` does so in advance, so that no
    image waits. Without a signature it is compiled for the types of each call (helpers called by other
    kernels).
    tuples : `NamedTuple` classes used in the signatures, their fields annotated as `F1`, `I2`, ..., or as a
    class earlier in this tuple, or as such a class or None.
    any_order : sums may be vectorised, in an order that is fixed at compilation; four times as fast. No other
    fastmath is used: NaN marks missing values in edged.
    Results are bit-equal on replay.
    """
    options: dict[str, Any] = {
        "nogil": True,
        "fastmath": {"reassoc", "contract"} if any_order else False,
        "error_model": "numpy",
    }
    if inline:
        options["inline"] = "always"

    def compile_it(function: F) -> F:
        dispatcher = numba.njit(**options)(function)
        if _cache_is_usable():
            dispatcher._cache = QuickCache(function)
        if signatures:
            _Deferred(dispatcher, signatures, tuples)
        return cast(F, dispatcher)

    return compile_it


class _Deferred:
    """A kernel whose machine code is loaded, or compiled, at its first call."""

    def __init__(self, dispatcher: Any, signatures: tuple[str, ...], tuples: Tuples) -> None:
        self._dispatcher, self._signatures, self._tuples = dispatcher, signatures, tuples
        self._lock = threading.Lock()
        # both stay in place: a thread may be about to call them while another one loads
        dispatcher._compile_for_args = self._called
        dispatcher.get_call_template = self._named
        dispatcher.deferred = self

    def load(self) -> None:
        """Load or compile the machine code, once."""
        with self._lock:
            if not self._dispatcher.signatures:
                if not isinstance(self._dispatcher._cache, QuickCache):
                    warn_compiling()  # there is no cache to load it from
                for signature in self._signatures:
                    self._dispatcher.compile(_parsed(signature, self._tuples))
                self._dispatcher.disable_compile(True)

    def _called(self, *_arguments: Any) -> Any:
        """Load at the first call; numba then calls the returned dispatcher with the same arguments."""
        self.load()
        return self._dispatcher

    def _named(self, arguments: Any, named: Any) -> Any:
        """Load while a kernel that calls this one is compiled."""
        self.load()
        return type(self._dispatcher).get_call_template(self._dispatcher, arguments, named)


def load_all(module: ModuleType) -> None:
    """Load, or compile, every kernel of a module."""
    for value in vars(module).values():
        if isinstance(value, Dispatcher) and hasattr(value, "deferred"):
            value.deferred.load()


def load_called(*packages: str) -> None:
    """Load the kernels that the Python code of packages calls, as far as they are imported.

    A kernel that only other kernels call is compiled into those: four of five are never called from Python.
    """
    modules = [
        module
        for name, module in tuple(sys.modules.items())
        if name.startswith(tuple(f"{package}." for package in packages))
    ]
    named = {name for module in modules for code in _python_of(module) for name in _names(code)}
    for module in modules:
        for name, value in tuple(vars(module).items()):
            if name in named and isinstance(value, Dispatcher) and hasattr(value, "deferred"):
                value.deferred.load()


def _python_of(module: ModuleType) -> Iterator[CodeType]:
    """Code of the functions and methods of a module, without that of its kernels."""
    for value in vars(module).values():
        for member in vars(value).values() if isinstance(value, type) else (value,):
            for function in _unwrapped(member):
                if function.__module__ == module.__name__:
                    yield function.__code__


def _unwrapped(value: object, deep: int = 2) -> Iterator[FunctionType]:
    """The function in a value, also if decorators have wrapped it."""
    if isinstance(value, FunctionType):
        yield value
    elif deep and not isinstance(value, Dispatcher | ModuleType):
        for name in WRAPPED:
            yield from _unwrapped(getattr(value, name, None), deep - 1)


def _names(code: CodeType) -> set[str]:
    """All names that a function uses, including those in functions nested in it."""
    inner = (const for const in code.co_consts if isinstance(const, CodeType))
    return set(code.co_names).union(*(_names(nested) for nested in inner))


def _parsed(signature: str, tuples: Tuples) -> Any:
    """A signature in numba's own terms."""
    if not tuples:
        return signature
    known: dict[str, Any] = {}
    for named in tuples:
        hints = get_type_hints(named, include_extras=True)
        fields = [_field(hint, known) for hint in hints.values()]
        alike = len(set(fields)) == 1
        known[named.__name__] = (
            types.NamedUniTuple(fields[0], len(fields), named) if alike else types.NamedTuple(fields, named)
        )
    result, *arguments = (known.get(text) or _type(text) for text in TYPE_NAME.findall(signature))
    return result(*arguments)


def _field(hint: Any, known: dict[str, Any]) -> Any:
    """The numba type of a field of a tuple."""
    if isinstance(hint, UnionType):
        return types.Optional(_field(hint.__args__[0], known))
    return known[hint.__name__] if isinstance(hint, type) else _type(hint.__metadata__[0])


def _type(text: str) -> Any:
    """The numba type of a name such as "f8[:, ::1]"."""
    arguments, _ = normalize_signature(f"({text},)")
    return arguments[0]


def for_kernel(array: npt.ArrayLike, dtype: type[np.generic]) -> npt.NDArray[Any]:
    """The array as kernels need it, contiguous and writable: a copy if needed. `np.require` is far slower."""
    plain = np.ascontiguousarray(array, dtype)
    return plain if plain.flags.writeable else plain.copy()


def _cache_is_usable() -> bool:
    """Whether numba's cache can be used: it raises at import if the directory cannot be written."""
    directory = os.environ.get("NUMBA_CACHE_DIR")
    return directory is None or os.access(directory, os.W_OK) or not Path(directory).exists()


T = TypeVar("T")
R = TypeVar("R")

_RIGHT = ThreadPoolExecutor(1, thread_name_prefix="right-camera")  # the left camera uses the caller's thread
_here = threading.local()


def for_both(work: Callable[[int], T]) -> tuple[T, T]:
    """(work(0), work(1)), the second in its own thread. An error of either is raised after both have ended.

    Within such work both run in its own thread, one after the other.
    """
    if getattr(_here, "is_shared", False):
        return work(0), work(1)

    def alone(number: int) -> T:
        _here.is_shared, _here.number = True, number
        try:
            return work(number)
        finally:
            _here.is_shared, _here.number = False, 0

    right = _RIGHT.submit(alone, 1)
    try:
        left = alone(0)
    finally:
        right.exception()  # waits
    return left, right.result()


def for_each(work: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """The results of work on each of some items, every second one in the other thread of `for_both`."""
    if len(items) < 2:
        return [work(item) for item in items]
    shares = for_both(lambda number: [work(item) for item in items[number::2]])
    return [shares[k % 2][k // 2] for k in range(len(items))]


def thread_number() -> int:
    """Which of both threads of `for_both` this is: 0, or 1 for that of the right camera."""
    return int(getattr(_here, "number", 0))
