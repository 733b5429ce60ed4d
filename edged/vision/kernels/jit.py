"""The one way kernels are compiled: ahead of use, without the GIL, cached on disk."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast, get_type_hints

import numba
import numpy as np
import numpy.typing as npt
from numba import types

from edged.vision.kernels.jitcache import QuickCache, load_quickly

F = TypeVar("F", bound=Callable[..., Any])

load_quickly()


F1 = Annotated[npt.NDArray[np.float64], "f8[::1]"]
F2 = Annotated[npt.NDArray[np.float64], "f8[:, ::1]"]
F3 = Annotated[npt.NDArray[np.float64], "f8[:, :, ::1]"]
I1 = Annotated[npt.NDArray[np.int64], "i8[::1]"]
I2 = Annotated[npt.NDArray[np.int64], "i8[:, ::1]"]
B1 = Annotated[npt.NDArray[np.bool_], "b1[::1]"]
INT = Annotated[int, "i8"]
"""Fields of a `NamedTuple` that a kernel takes: contiguous arrays of so many dimensions, an integer."""


def kernel(
    *signatures: str,
    tuples: tuple[type[tuple[Any, ...]], ...] = (),
    inline: bool = False,
    any_order: bool = False,
) -> Callable[[F], F]:
    """Compile a plain-loop function to machine code.

    signatures : numba signatures, e.g. "f8(f4[:, ::1], f8, f8)"; compiled at import, so a
    warm start never waits for the first image. Without a signature it is compiled on first use
    (helpers called by other kernels).
    tuples : `NamedTuple` classes that the signatures name, their fields annotated as `F1`, `I2`, ...
    any_order : sums may be added side by side, in an order that is fixed when it is compiled; four times
    faster. Otherwise no fastmath: NaN marks missing values in edged.
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
        for signature in signatures:
            dispatcher.compile(_parsed(signature, tuples))
        dispatcher.disable_compile(bool(signatures))
        return cast(F, dispatcher)

    return compile_it


def _parsed(signature: str, tuples: tuple[type[tuple[Any, ...]], ...]) -> Any:
    """A signature in numba's own terms."""
    if not tuples:
        return signature
    known = dict(vars(types))
    for one in tuples:
        hints = get_type_hints(one, include_extras=True)
        fields = [eval(hint.__metadata__[0], {}, known) for hint in hints.values()]
        alike = len(set(fields)) == 1
        known[one.__name__] = (
            types.NamedUniTuple(fields[0], len(fields), one) if alike else types.NamedTuple(fields, one)
        )
    return eval(signature, {}, known)


def for_kernel(array: npt.ArrayLike, dtype: type[np.generic]) -> npt.NDArray[Any]:
    """The array as kernels take it: a copy of what is a view or read-only. `np.require` takes far longer."""
    plain = np.ascontiguousarray(array, dtype)
    return plain if plain.flags.writeable else plain.copy()


def _cache_is_usable() -> bool:
    """numba raises at import where its cache directory cannot be written; run uncached there."""
    directory = os.environ.get("NUMBA_CACHE_DIR")
    return directory is None or os.access(directory, os.W_OK) or not Path(directory).exists()
