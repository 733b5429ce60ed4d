"""The Aravis library: loading it, translating its errors, discovering cameras and connecting to them."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import ipaddress
import logging
import math
import socket
import struct
import threading
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

from edged.errors import CameraBusy, CameraSetupError, CameraUnreachable, CaptureError

log = logging.getLogger(__name__)

INSTALL_HINT = "install it with: apt install gir1.2-aravis-0.8 python3-gi"

GVCP_PORT = 3956

ANSWER_S = 0.3
"""Wait for the answer to a read, which takes milliseconds."""

CONTROL_PRIVILEGE_REGISTER = 0x0A00
"""GigE Vision bootstrap register "control channel privilege"."""

CONTROLLED = 0b11
"""Its bits for exclusive access and control access; with neither, the camera is not controlled."""

PARSING = threading.Lock()
"""Held while Aravis parses a camera's description: its parser has one state for the whole process
(`_parse_memory` in arvdomparser.c, 0.8), and two threads in it would free each other's objects."""

DEVICE_ERROR_DOMAIN = "arv-device-error-quark"
DEVICE_ERRORS: dict[str, type[CaptureError]] = {
    "WRONG_FEATURE": CameraSetupError,
    "FEATURE_NOT_FOUND": CameraSetupError,
    "NOT_CONNECTED": CameraUnreachable,
    "PROTOCOL_ERROR": CameraUnreachable,
    "TRANSFER_ERROR": CameraUnreachable,
    "TIMEOUT": CameraUnreachable,
    "NOT_FOUND": CameraUnreachable,
    "INVALID_PARAMETER": CameraSetupError,
    "GENICAM_NOT_FOUND": CameraSetupError,
    "NO_STREAM_CHANNEL": CameraSetupError,
    "NOT_CONTROLLER": CameraBusy,
    "UNKNOWN": CameraUnreachable,
    "PROTOCOL_ERROR_NOT_IMPLEMENTED": CameraSetupError,
    "PROTOCOL_ERROR_INVALID_PARAMETER": CameraSetupError,
    "PROTOCOL_ERROR_INVALID_ADDRESS": CameraSetupError,
    "PROTOCOL_ERROR_WRITE_PROTECT": CameraSetupError,
    "PROTOCOL_ERROR_BAD_ALIGNMENT": CameraSetupError,
    "PROTOCOL_ERROR_ACCESS_DENIED": CameraBusy,
    # GVCP status 0x8007: the camera itself is busy; it is not controlled by another host
    "PROTOCOL_ERROR_BUSY": CameraUnreachable,
}
"""Our errors by the name of `Aravis.DeviceError`; every GenICam error (`Aravis.GcError`) is a setup error."""


class Library(NamedTuple):
    """The two GObject namespaces in use; they ship no types."""

    aravis: Any
    glib: Any


@functools.cache
def _load() -> Library | str:
    """Load the library; return it, or why that is not possible."""
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        with warnings.catch_warnings():
            # PyGObject before 3.44 still has an importer of Python 2, about which Python warns
            warnings.simplefilter("ignore", ImportWarning)
            from gi.repository import Aravis, GLib
    except ImportError as error:
        return f"PyGObject is missing ({error}); {INSTALL_HINT}"
    except ValueError as error:
        return f"Aravis 0.8 is missing ({error}); {INSTALL_HINT}"
    if hasattr(Aravis, "set_interface_flags"):  # 0.8.23
        # a camera in another network can answer only by broadcast
        Aravis.set_interface_flags("GigEVision", int(Aravis.GvInterfaceFlags.ACK))
    return Library(Aravis, GLib)


def aravis_missing() -> str:
    """Why cameras cannot be used on this machine, with the command that fixes it; "" if they can."""
    loaded = _load()
    return loaded if isinstance(loaded, str) else ""


def library(camera: str) -> Library:
    """Return the library. Raises `CameraSetupError`, for the camera that needs it, if it is missing."""
    loaded = _load()
    if isinstance(loaded, str):
        raise CameraSetupError(camera, loaded)
    return loaded


@contextlib.contextmanager
def translated(camera: str, doing: str) -> Iterator[None]:
    """Turn errors of GLib and the operating system into a `CaptureError` that says what was being done."""
    glib = library(camera).glib
    try:
        yield
    except glib.Error as error:
        raise translate(camera, doing, error) from error
    except OSError as error:  # no descriptor for a socket, for example
        raise CameraUnreachable(camera, f"{doing}: {error.strerror or error}") from error


def translate(camera: str, doing: str, error: Any) -> CaptureError:
    """Return the `CaptureError` for a GLib error; for unknown codes and domains (sockets, files) it is
    `CameraUnreachable`."""
    aravis = library(camera).aravis
    message = f"{doing}: {error.message}"
    if error.domain == DEVICE_ERROR_DOMAIN:
        names = {int(getattr(aravis.DeviceError, name)): name for name in DEVICE_ERRORS}
        return DEVICE_ERRORS.get(names.get(error.code, ""), CameraUnreachable)(camera, message)
    if error.domain == "arv-gc-error-quark":
        return CameraSetupError(camera, message)
    return CameraUnreachable(camera, message)


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """A camera that answered discovery.

    device_id : Aravis' own id. address : IP address, or USB bus position.
    protocol : "GigEVision" or "USB3Vision". physical_id : MAC address, or USB GUID.
    control : "free", "controlled" by some program, or why it cannot be used; "" if not queried.
    """

    device_id: str
    vendor: str
    model: str
    serial: str
    address: str
    protocol: str
    physical_id: str
    control: str = ""


def list_cameras() -> list[CameraInfo]:
    """Every camera that answers within Aravis' discovery time (1 s), sorted by serial number.

    Blocks: call it in a thread. Raises `CameraSetupError` when Aravis is missing.
    """
    return [
        dataclasses.replace(info, control=control_state(info.address))
        if info.protocol == "GigEVision"
        else info
        for info in _discovery.run(max_age_s=0.0)
    ]


class _Discovery:
    """Discovery of cameras; a single instance, as Aravis keeps one list of devices for the process.

    Two cameras that are opened at the same time share one round of discovery.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._found: list[CameraInfo] = []
        self._done_s = -math.inf

    def address_of(self, device: str) -> str:
        """Address of a camera that was found at any time; an unknown `device` is returned unchanged."""
        matching = (info.address for info in self._found if device in (info.serial, info.device_id))
        return next(matching, device)

    def run(self, max_age_s: float) -> list[CameraInfo]:
        """Return the cameras found, after a new round of discovery if the last is older than this."""
        aravis = library("any").aravis
        asked_s = time.monotonic()
        with self._lock:
            if self._done_s < asked_s - max_age_s:
                with translated("any", "discovery"):
                    aravis.update_device_list()
                    self._found = [_info(aravis, index) for index in range(aravis.get_n_devices())]
                self._done_s = time.monotonic()
            return sorted(self._found, key=lambda info: (info.serial, info.address))


_discovery = _Discovery()


def address_of(device: str) -> str:
    """IP address of a camera; a serial number that no discovery has found yet is returned unchanged."""
    return _discovery.address_of(device)


def _info(aravis: Any, index: int) -> CameraInfo:
    return CameraInfo(
        device_id=aravis.get_device_id(index) or "",
        vendor=aravis.get_device_vendor(index) or "",
        model=aravis.get_device_model(index) or "",
        serial=aravis.get_device_serial_nbr(index) or "",
        address=aravis.get_device_address(index) or "",
        protocol=aravis.get_device_protocol(index) or "",
        physical_id=aravis.get_device_physical_id(index) or "",
    )


def control_state(address: str) -> str:
    """Whether a GigE Vision camera is "free" or "controlled", or why that is unknown; does not take control.

    A camera that answers a broadcast but not this is in another network than the host's port.
    """
    request_id = 1
    # GVCP READREG_CMD: key, flags (answer wanted), command, length, id, register address
    command = struct.pack(">BBHHHI", 0x42, 0x01, 0x0080, 4, request_id, CONTROL_PRIVILEGE_REGISTER)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.settimeout(ANSWER_S)
        try:
            udp.connect((address, GVCP_PORT))
            for _ in range(2):  # one datagram may be lost
                udp.send(command)
                with contextlib.suppress(TimeoutError):
                    answer = udp.recv(64)
                    break
            else:
                return "does not answer: is its address in the network of this port?"
        except OSError as error:
            return f"cannot be reached: {error.strerror or error}"
    if len(answer) < 12 or answer[:4] != b"\x00\x00\x00\x81":  # success, READREG_ACK
        return "does not tell who controls it"
    return "controlled" if int.from_bytes(answer[8:12]) & CONTROLLED else "free"


def connect(camera: str, device: str, serial: str = "") -> Any:
    """Connect to the camera with this IP address, serial number or Aravis id; return its `Aravis.Camera`.

    An address is contacted directly, also across routers; anything else must be found by discovery. A camera
    that does not answer at its address may have a new one: it is looked for by its serial number, if that is
    given. Raises `CameraUnreachable`; takes a few seconds at most.
    """
    try:
        ipaddress.ip_address(device)
    except ValueError:
        return _connect(camera, _find(camera, device))
    try:
        return _connect(camera, device)
    except CameraUnreachable:
        if not serial:
            raise
    moved = _find(camera, serial)
    log.warning("camera %s: %s does not answer, but %s does at %s", camera, device, serial, moved)
    return _connect(camera, moved)


def _connect(camera: str, device_id: str) -> Any:
    aravis = library(camera).aravis
    with PARSING, translated(camera, f"connecting to {device_id}"):
        return aravis.Camera.new(device_id)


def _find(camera: str, device: str) -> str:
    """Address or Aravis id of the camera with this serial number or id, by discovery."""
    found = _discovery.run(max_age_s=0.5)
    matching = [info for info in found if device in (info.serial, info.device_id)]
    if not matching:
        seen = ", ".join(f"{info.serial} ({info.address})" for info in found) or "none"
        raise CameraUnreachable(camera, f"no camera with serial number {device!r} answers; found: {seen}")
    if len(matching) > 1:
        where = ", ".join(info.address for info in matching)
        raise CameraSetupError(camera, f"serial number {device!r} answers at {where}: give the IP address")
    return matching[0].address if matching[0].protocol == "GigEVision" else matching[0].device_id
