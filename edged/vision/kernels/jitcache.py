"""Kernels from numba's disk cache in less than half of the time, because every start waits for them.

A cached kernel is object code, which runs, and bitcode, which only another kernel needs that calls it and is
compiled later. numba 0.68 parses the bitcode at every load, and before each load it registers all that it can
compile. Here both wait until something is compiled. What is stored, and what runs, stays the same
(`tools/bench kernels`).
"""

from __future__ import annotations

import functools
import hashlib
import itertools
import logging
import os
import shutil
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    UserProvidedCacheLocator,
)
from numba.core.codegen import CodeLibrary, JITCodeLibrary
from numba.core.dispatcher import Dispatcher
from numba.core.registry import cpu_target
from numba.core.runtime import rtsys

log = logging.getLogger(__name__)
COMPILING = "compiling numerical kernels (once, up to three minutes)"
_said = itertools.count()


def say_compiling() -> None:
    """Once in a process, before the first kernel that is compiled: whoever waits knows for what."""
    if next(_said) == 0:  # one step: both cameras' threads may come here
        log.warning(COMPILING)


class RealPlace(UserProvidedCacheLocator):  # type: ignore[misc]  # numba ships no types
    """Where kernels of a source are stored, by whatever link it was reached, as `current` to a version."""

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        """A folder's name for that of the source."""
        return str(super().get_suitable_cache_subpath(os.path.realpath(py_file)))


class StoredResult(CompileResultCacheImpl):  # type: ignore[misc]  # as above
    """What is stored of a kernel, and where."""

    _locator_classes = (RealPlace, *CompileResultCacheImpl._locator_classes)


class QuickCache(FunctionCache):  # type: ignore[misc]  # as above
    """numba's cache of one function, of which kernels are loaded without getting ready to compile."""

    _impl_class = StoredResult

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        stamp = self._impl.locator.get_source_stamp()
        self._cache_file = StoredIndex(self._cache_path, self._impl.filename_base, stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled kernel of a signature, or None where it has not been stored."""
        rtsys.initialize(target_context)  # a kernel asks it for the memory of new arrays
        stored = self._load_overload(sig, target_context)
        if stored is None:
            say_compiling()
        return stored

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        """numba's key, and what is frozen into the code, which may come from another file."""
        return (*super()._index_key(sig, codegen), frozen_into(self._py_func))


class StoredIndex(IndexDataCacheFile):  # type: ignore[misc]  # as above
    """What is stored of one function; nothing where a class in its types has been renamed or moved since."""

    def _load_index(self) -> dict[Any, str]:
        try:
            return dict(super()._load_index())
        except (AttributeError, ImportError):
            return {}


def take_over(compiled: Path, packages: Path, kernels: Path, own: Path) -> None:
    """Give sources in another folder what is compiled of the same sources; numba tells by their hash.

    compiled, kernels : numba's caches. packages, own : where the packages lie of which they are. A cache has
    a folder for each folder of sources, named by its path.
    """
    for folder in {file.parent for file in packages.glob("edged/**/*.py")}:
        before, after = (
            RealPlace.get_suitable_cache_subpath(str(place / "any.py"))
            for place in (folder, own / folder.relative_to(packages))
        )
        if (compiled / before).is_dir():
            shutil.copytree(compiled / before, kernels / after, dirs_exist_ok=True)


def frozen_into(function: FunctionType) -> str:
    """Global numbers that a kernel reads, the kernels that it calls, and what is frozen into those.

    numba asks for a kernel's own file only: called ones from another file would stay as they were.
    """
    found: dict[tuple[str, str], str] = {}
    functions, seen = [function], {function}
    while functions:
        reader = functions.pop()
        found[reader.__module__, f"{reader.__qualname__}()"] = _digest(reader.__code__)
        for name in sorted({*reader.__code__.co_names} & {*reader.__globals__}):
            value = reader.__globals__[name]
            if isinstance(value, int | float | tuple):
                found[reader.__module__, name] = repr(value)
            elif isinstance(value, np.ndarray):
                found[reader.__module__, name] = repr(value.tolist())
            elif isinstance(value, Dispatcher) and value.py_func not in seen:
                seen.add(value.py_func)
                functions.append(value.py_func)
    return repr(sorted(found.items()))


@functools.cache
def _digest(code: CodeType) -> str:
    """Tells one function's code from another's, wherever its lines stand."""
    constants = [_digest(value) if isinstance(value, CodeType) else repr(value) for value in code.co_consts]
    identity = repr((code.co_code, code.co_names, code.co_varnames, code.co_freevars, constants))
    return hashlib.sha256(identity.encode()).hexdigest()


class StoredLibrary(JITCodeLibrary):  # type: ignore[misc]  # as above
    """Compiled code; what comes from the cache keeps its bitcode unparsed until a kernel links it."""

    _bitcode: bytes | None = None

    @classmethod
    def _unserialize(cls, codegen: Any, state: tuple[str, str, Any]) -> CodeLibrary:
        name, kind, data = state
        if kind != "object":
            return super()._unserialize(codegen, state)
        library = codegen.create_library(name)
        object_code, library._bitcode = data
        library.enable_object_caching()
        library._set_compiled_object(object_code)
        library._finalize_final_module()
        return library

    def get_pointer_to_function(self, name: str) -> int:
        """The address of a function of this kernel.

        numba asks its list of symbols first, for which the bitcode would have to be parsed. Of a kernel from
        the cache it asks for nothing but the function that the kernel was stored for.
        """
        if self._bitcode is None:
            return int(super().get_pointer_to_function(name))
        return int(self._codegen._engine.get_function_address(name))

    def _get_module_for_linking(self) -> Any:
        if self._bitcode is not None:
            self._shared_module = llvm.parse_bitcode(self._bitcode)
            self._codegen._engine._load_defined_symbols(self._shared_module)
            self._bitcode = None
        return super()._get_module_for_linking()


def load_quickly() -> None:
    """Let all code that numba loads in this process from now on be a `StoredLibrary`."""
    cpu_target.target_context.codegen()._library_class = StoredLibrary
