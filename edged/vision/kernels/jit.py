"""The one way kernels are compiled: ahead of use, without the GIL, cached on disk."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt

from edged.vision.kernels.jitcache import QuickCache, load_quickly

F = TypeVar("F", bound=Callable[..., Any])

load_quickly()


def kernel(*signatures: str, inline: bool = False, any_order: bool = False) -> Callable[[F], F]:
    """Compile a plain-loop function to machine code.

    signatures : numba signatures, e.g. "f8(f4[:, ::1], f8, f8)"; compiled at import, so a
    warm start never waits for the first image. Without a signature it is compiled on first use
    (helpers called by other kernels).
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
            dispatcher.compile(signature)
        dispatcher.disable_compile(bool(signatures))
        return cast(F, dispatcher)

    return compile_it


def for_kernel(array: npt.ArrayLike, dtype: type[np.generic]) -> npt.NDArray[Any]:
    """The array as kernels take it: a copy of what is a view or read-only. `np.require` takes far longer."""
    plain = np.ascontiguousarray(array, dtype)
    return plain if plain.flags.writeable else plain.copy()


def _cache_is_usable() -> bool:
    """numba raises at import where its cache directory cannot be written; run uncached there."""
    directory = os.environ.get("NUMBA_CACHE_DIR")
    return directory is None or os.access(directory, os.W_OK) or not os.path.exists(directory)  # noqa: PTH110
