"""GenICam nodes by name: checked before anything is written, written in a safe order, read back."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Any

from edged.adapters.aravis.library import DEVICE_ERROR_DOMAIN, library, translated
from edged.adapters.aravis.names import FRAME_RATE, FRAME_RATE_AUTO, FRAME_RATE_ENABLE
from edged.errors import CameraSetupError

Value = bool | int | float | str

ORDER = (
    ("UserSetSelector",),
    ("UserSetLoad",),
    ("BinningHorizontal", "BinningVertical", "DecimationHorizontal", "DecimationVertical", "PixelFormat"),
    ("Width", "Height"),
    ("OffsetX", "OffsetY"),
    (),  # everything else, in the given order: a selector comes before the features that it selects
    FRAME_RATE_ENABLE,
    (FRAME_RATE_AUTO,),
    FRAME_RATE,
)
"""Order of writing: loading a user set overwrites the rest, binning changes the limits of the region, and a
region must fit before it is moved."""

FLOAT_TOLERANCE = 0.01
"""Relative tolerance for rounding to a camera's steps (a line time, a tenth of a dB); more is clamping."""


class Features:
    """The feature nodes of one open device; every method must run on its control thread.

    maker : names of the maker and of the model.
    """

    def __init__(self, camera: str, device: Any, maker: tuple[str, str] = ("", "")) -> None:
        self._camera = camera
        self._device = device
        self.maker = maker
        self._library = library(camera)

    def exists(self, name: str) -> bool:
        """Whether the camera has the feature and it is available in the current state."""
        try:
            return bool(self._device.is_feature_available(name))
        except self._library.glib.Error:
            return False

    def first(self, *names: str) -> str:
        """The first of several names that the camera has; "" if none."""
        return next((name for name in names if self.exists(name)), "")

    def writable(self, name: str) -> bool:
        """Whether the camera has the feature and it can be written in the current state."""
        if not self.exists(name):
            return False
        aravis = self._library.aravis
        return bool(self._device.get_feature(name).get_actual_access_mode() != aravis.GcAccessMode.RO)

    def choices(self, name: str) -> list[str]:
        """Entries of an enumeration; empty if the camera does not have it, or has it as a number."""
        enumeration = self._library.aravis.GcEnumeration
        if not self.exists(name) or not isinstance(self._device.get_feature(name), enumeration):
            return []
        with translated(self._camera, f"asking for the choices of {name}"):
            return list(self._device.dup_available_enumeration_feature_values_as_strings(name))

    def value(self, name: str) -> Value | None:
        """Current value of a feature; None if it cannot be read."""
        with translated(self._camera, f"reading {name}"):
            return self._read(name)

    def title(self, name: str) -> str:
        """Display name of a feature in the maker's own program, followed by its name if that differs."""
        node = self._device.get_feature(name)
        shown = node.get_display_name() if isinstance(node, self._library.aravis.GcFeatureNode) else None
        return f'"{shown}" ({name})' if shown and shown != name else name

    def number(self, name: str, value: float) -> float | int:
        """Return a value in the type of the feature: rounded if it is an integer."""
        is_float = isinstance(self._device.get_feature(name), self._library.aravis.GcFloat)
        return value if is_float else round(value)

    def nearest(self, name: str, value: int) -> int:
        """Clamp a value to the limits of an integer feature."""
        with translated(self._camera, f"asking for the limits of {name}"):
            low, high = self._device.get_integer_feature_bounds(name)
        return int(min(max(value, low), high))

    def bounds(self, name: str) -> tuple[float, float]:
        """Current limits of a numeric feature."""
        aravis = self._library.aravis
        with translated(self._camera, f"asking for the limits of {name}"):
            if isinstance(self._device.get_feature(name), aravis.GcFloat):
                low, high = self._device.get_float_feature_bounds(name)
            else:
                low, high = self._device.get_integer_feature_bounds(name)
        return float(low), float(high)

    def described(self) -> list[dict[str, Any]]:
        """All features as the maker describes them: name, kind, access, text in the menu, choices."""
        aravis = self._library.aravis
        found, seen, waiting = list[dict[str, Any]](), set[str](), ["Root"]
        while waiting:
            name = waiting.pop()
            node = self._device.get_feature(name)
            if name in seen or node is None:
                continue
            seen.add(name)
            if isinstance(node, aravis.GcCategory):
                waiting += reversed(node.get_features())
            elif isinstance(node, aravis.GcFeatureNode):
                entry = {
                    "name": name,
                    "kind": node.get_node_name(),
                    "access": node.get_actual_access_mode().value_nick,
                    "menu": node.get_display_name() or "",
                }
                found.append(entry | ({"choices": choices} if (choices := self.choices(name)) else {}))
        return found

    def check(self, values: Mapping[str, Value]) -> list[str]:
        """Check names, types and choices of settings without writing; return the errors."""
        return [
            f"{name}: {problem}" for name, value in values.items() if (problem := self._misfit(name, value))
        ]

    def apply(self, values: Mapping[str, Value]) -> list[str]:
        """Write in a safe order, read back and compare; return the refusals and differences."""
        problems: list[str] = []
        if {"Width", "Height"} & values.keys():
            for offset in ("OffsetX", "OffsetY"):  # else a wide region may not fit at the last one's offset
                if self.exists(offset):
                    with contextlib.suppress(self._library.glib.Error):
                        self._write(offset, 0)
        for name in sorted(values, key=_stage):
            problem = self._put(name, values[name])
            if not problem and not _same(values[name], found := self._read(name)):
                problem = f"{name}: the camera made {found!r} of {values[name]!r}"
            if problem:
                problems.append(problem)
        return problems

    def write(self, values: Mapping[str, Value]) -> list[str]:
        """Write in the given order without reading back; return the refusals."""
        with translated(self._camera, "setting"):
            return [problem for name, value in values.items() if (problem := self._put(name, value))]

    def _put(self, name: str, value: Value) -> str:
        """Write one feature; return why it was refused, or ""."""
        try:
            self._allowed(name, value)
            self._write(name, value)
        except _RefusedError as error:
            return f"{name}: {error}"
        except self._library.glib.Error as error:
            if error.domain == DEVICE_ERROR_DOMAIN and error.code == int(
                self._library.aravis.DeviceError.TIMEOUT
            ):
                raise  # a missing answer is not a refusal
            return f"{name} = {value!r}: {error.message}"
        return ""

    def require(self, values: Mapping[str, Value]) -> None:
        """Check, then apply settings. Raises `CameraSetupError` that names every problem."""
        problems = self.check(values) or self.apply(values)
        if problems:
            raise CameraSetupError(self._camera, "; ".join(problems))

    def _misfit(self, name: str, value: Value) -> str:
        aravis = self._library.aravis
        node = self._device.get_feature(name)
        if node is None or not isinstance(node, aravis.GcFeatureNode):
            return "the camera has no such feature"
        if isinstance(node, aravis.GcCommand):
            return "" if value is True else f"a command; expected true, got {value!r}"
        if isinstance(node, aravis.GcEnumeration):  # before GcInteger and GcString, which it also is
            choices = list(self._device.dup_available_enumeration_feature_values_as_strings(name))
            return "" if value in choices else f"{value!r} is none of {', '.join(choices)}"
        for kind, types, expected in (
            (aravis.GcBoolean, bool, "true or false"),
            (aravis.GcFloat, int | float, "a number"),
            (aravis.GcInteger, int, "a whole number"),
            (aravis.GcString, str, "text"),
        ):
            if isinstance(node, kind):
                # in Python, True is the number 1
                fits = isinstance(value, types) and isinstance(value, bool) == (types is bool)
                return "" if fits else f"expected {expected}, got {value!r}"
        return "a feature of a kind that cannot be set"

    def _allowed(self, name: str, value: Value) -> None:
        """Check access and limits, which Aravis does not; some firmware would clamp the value, some take any.

        Raises `_RefusedError`.
        """
        aravis, node = self._library.aravis, self._device.get_feature(name)
        if node.get_actual_access_mode() == aravis.GcAccessMode.RO:
            raise _RefusedError("can only be read, or is locked by another feature")
        if isinstance(node, aravis.GcEnumeration | aravis.GcBoolean) or not isinstance(value, int | float):
            return
        if isinstance(node, aravis.GcFloat):
            low, high = self._device.get_float_feature_bounds(name)
        elif isinstance(node, aravis.GcInteger):
            low, high = self._device.get_integer_feature_bounds(name)
        else:
            return
        if not low <= value <= high:
            raise _RefusedError(f"{value!r} is outside {low:g} to {high:g}")

    def _write(self, name: str, value: Value) -> None:
        aravis, device = self._library.aravis, self._device
        node = device.get_feature(name)
        if isinstance(node, aravis.GcCommand):
            device.execute_command(name)
        elif isinstance(node, aravis.GcBoolean):
            device.set_boolean_feature_value(name, value)
        elif isinstance(value, str):
            device.set_string_feature_value(name, value)
        elif isinstance(node, aravis.GcFloat):
            device.set_float_feature_value(name, float(value))
        else:
            device.set_integer_feature_value(name, value)

    def _read(self, name: str) -> Value | None:
        """Current value; None for a command, or a write-only feature."""
        aravis, device = self._library.aravis, self._device
        node = device.get_feature(name)
        if isinstance(node, aravis.GcCommand) or node.get_actual_access_mode() == aravis.GcAccessMode.WO:
            return None
        if isinstance(node, aravis.GcBoolean):
            return bool(device.get_boolean_feature_value(name))
        if isinstance(node, aravis.GcEnumeration | aravis.GcString):
            return str(device.get_string_feature_value(name))
        if isinstance(node, aravis.GcFloat):
            return float(device.get_float_feature_value(name))
        return int(device.get_integer_feature_value(name))


class _RefusedError(Exception):
    pass


def _stage(name: str) -> int:
    return next((stage for stage, names in enumerate(ORDER) if name in names), ORDER.index(()))


def _same(wanted: Value, found: Value | None) -> bool:
    if found is None:
        return True
    if isinstance(found, float) and isinstance(wanted, int | float):
        return abs(found - wanted) <= FLOAT_TOLERANCE * max(abs(wanted), abs(found))
    return wanted == found
