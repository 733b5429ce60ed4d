"""Faster loading of kernels from numba's disk cache, as every start waits for it: less than half the time.

A cached kernel consists of object code, which runs, and bitcode, which is only needed when another kernel
that calls it is compiled later. numba 0.68 parses the bitcode at every load, and before each load it
registers everything that it can compile. Here both are deferred until something is compiled. The stored
files and the code that runs are unchanged (`tools/bench kernels`).
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


def warn_compiling() -> None:
    """Log once per process, before the first kernel is compiled, what the user is waiting for."""
    if next(_said) == 0:  # atomic: the threads of both cameras may come here
        log.warning(COMPILING)


class RealPlace(UserProvidedCacheLocator):  # type: ignore[misc]  # numba ships no types
    """Cache location of a source file by its real path, even if it is reached by a link such as `current`."""

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        """Name of the cache folder for the folder of a source file."""
        return str(super().get_suitable_cache_subpath(os.path.realpath(py_file)))


class StoredResult(CompileResultCacheImpl):  # type: ignore[misc]  # as above
    """Storage of compiled kernels, at the places of `RealPlace` first."""

    _locator_classes = (RealPlace, *CompileResultCacheImpl._locator_classes)


class QuickCache(FunctionCache):  # type: ignore[misc]  # as above
    """numba's cache of one function, which loads kernels without preparing the compiler."""

    _impl_class = StoredResult

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        stamp = self._impl.locator.get_source_stamp()
        self._cache_file = StoredIndex(self._cache_path, self._impl.filename_base, stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled kernel of a signature, or None if it is not stored."""
        rtsys.initialize(target_context)  # kernels get the memory of new arrays from it
        stored = self._load_overload(sig, target_context)
        if stored is None:
            warn_compiling()
        return stored

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        """numba's key, extended by what is frozen into the code, possibly from other files."""
        return (*super()._index_key(sig, codegen), frozen_into(self._py_func))


class StoredIndex(IndexDataCacheFile):  # type: ignore[misc]  # as above
    """Index of one function's stored kernels; empty if a class in its types was renamed or moved since."""

    def _load_index(self) -> dict[Any, str]:
        try:
            return dict(super()._load_index())
        except (AttributeError, ImportError):
            return {}


def take_over(compiled: Path, packages: Path, kernels: Path, own: Path) -> None:
    """Copy compiled kernels to the cache of the same sources in another folder; numba compares their hashes.

    compiled, kernels : numba's caches, from and to. packages, own : the folders of the packages that they
    belong to. A cache has a folder for each folder of sources, named by its path.
    """
    for folder in {file.parent for file in packages.glob("edged/**/*.py")}:
        before, after = (
            RealPlace.get_suitable_cache_subpath(str(place / "any.py"))
            for place in (folder, own / folder.relative_to(packages))
        )
        if (compiled / before).is_dir():
            shutil.copytree(compiled / before, kernels / after, dirs_exist_ok=True)


def frozen_into(function: FunctionType) -> str:
    """Global numbers that a kernel reads, the kernels that it calls, and the same for those.

    numba checks only a kernel's own file: without this, changed callees in other files would stay as
    compiled.
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
    """Hash of a function's code, independent of its line numbers."""
    constants = [_digest(value) if isinstance(value, CodeType) else repr(value) for value in code.co_consts]
    identity = repr((code.co_code, code.co_names, code.co_varnames, code.co_freevars, constants))
    return hashlib.sha256(identity.encode()).hexdigest()


class StoredLibrary(JITCodeLibrary):  # type: ignore[misc]  # as above
    """Compiled code; code from the cache keeps its bitcode unparsed until a kernel links it."""

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

        numba first consults its list of symbols, for which the bitcode would have to be parsed. For a kernel
        from the cache, it asks only for the function that the kernel was stored for.
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
    """Make numba use `StoredLibrary` for all code that it loads in this process from now on."""
    cpu_target.target_context.codegen()._library_class = StoredLibrary
