"""Every error that edged raises on purpose.

    EdgedError
    ├── UserError                 wrong usage or input: exit code 2, no stack trace
    │   ├── ConfigError           a configuration file; carries every mistake at once
    │   ├── FileFormatError       a rig, job, model or recording that cannot be used
    │   ├── ImageError            an image that cannot be read or does not fit
    │   ├── CalibrationError      calibration images that cannot give a calibration
    │   │   └── Undetermined      views, poses or points that do not determine the result: add more, elsewhere
    │   └── TeachError            a region that cannot give a job
    ├── CaptureError              a camera did not deliver: a fault, the daemon continues
    │   ├── CameraUnreachable     not found, or not answering
    │   │   └── CameraRestarted   it was power-cycled, or gave up the connection
    │   ├── CameraBusy            another host controls it
    │   ├── CameraSetupError      it refuses a setting
    │   │   └── WrongCamera       not the camera that was calibrated
    │   ├── FrameTimeout          no image in time
    │   │   └── StreamStalled     several times in a row, though the camera answers
    │   ├── FrameIncomplete       packets lost, short or scrambled data
    │   └── PairingError          two frames that are not one exposure
    │       ├── FrameRepeated     the number of an earlier frame
    │       ├── FrameFrozen       a new number, but the previous picture in every pixel
    │       ├── FrameUnpaired     one camera exposed, the other did not
    │       └── ExposuresDiffer   two exposures of one cycle that do not show the same
    ├── CommandRefused            a command that cannot be carried out (queue full, unknown job, ...)
    │   └── BeingSetUp            the cell is in SETUP: no commands are served
    ├── TaskFailed                long work that ended without a result: its process was killed, or a bug
    │   └── TaskTooLarge          it took more memory or time than it may, and would do so again
    ├── LinkError                 the other process cannot be reached, or sent an invalid message
    ├── RegressionNeeded          a job or rig that makes recorded cycles worse, or was not tried on them
    ├── SetupRefused              SETUP cannot be entered, or the token's lease has ended
    ├── PlcFault                  a PLC whose memory cannot be read or written: the cell keeps trying
    └── ListenError               a port or socket that cannot be opened
        └── TookTooLong           a server did not start or end within its time

An expected miss (no target, low quality) is a `domain.Status`, never an exception.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_FOLDERS = re.compile(r"(?<![\w/.:~-])/(?:[^\s/:;,'\"<>()|]+/)+")


def without_folders(text: str) -> str:
    """Message for readers outside this machine: each absolute path is cut to its last part.

    >>> without_folders("/var/lib/edged/rig.json: not JSON; see /setup")
    'rig.json: not JSON; see /setup'
    """
    return _FOLDERS.sub("", text)


def printable(text: str) -> str:
    """Make untrusted text safe for a terminal: control characters are replaced, line ends too.

    >>> printable("rig\\x1b[2J")
    'rig�[2J'
    """
    return "".join(letter if letter.isprintable() else "�" for letter in text)


class EdgedError(Exception):
    """Base class of all errors of edged."""


class UserError(EdgedError):
    """Wrong usage or input. The message names the place and what was expected.

    code : identifies the mistake within its class, for callers that have their own text for it; "" if none.
    params : values for such a text.
    """

    def __init__(self, message: str, code: str = "", **params: str | float) -> None:
        self.code = code
        self.params = params
        super().__init__(message)


class ConfigError(UserError):
    """A configuration that cannot be used.

    problems : one line each, `dotted.path: what is wrong, what was expected`.
    """

    def __init__(self, source: str, problems: list[str]) -> None:
        self.source = source
        self.problems = problems
        lines = "\n".join(f"  {problem}" for problem in problems)
        super().__init__(f"{source}: {len(problems)} problem{'s' if len(problems) != 1 else ''}\n{lines}")


class FileFormatError(UserError):
    """A file that is missing, damaged or of another kind."""


class ImageError(UserError):
    """An image that cannot be read or has the wrong size, depth or channels."""


class CalibrationError(UserError):
    """Calibration input that cannot give a trustworthy calibration."""


class Undetermined(CalibrationError):
    """Views, or poses and points of a robot, that do not determine the result."""


class TeachError(UserError):
    """A teaching image or region that cannot give a job."""


class CaptureError(EdgedError):
    """A camera did not deliver.

    camera : name of the camera ("left", "right", or "both").
    code : stable number for the PLC's error register.
    """

    code = 100

    def __init__(self, camera: str, message: str) -> None:
        self.camera = camera
        super().__init__(f"{'both cameras' if camera == 'both' else f'camera {camera}'}: {message}")


class CameraUnreachable(CaptureError):
    """Not found on the network, or not answering."""

    code = 101


class CameraBusy(CaptureError):
    """Another host holds the control privilege."""

    code = 102


class CameraSetupError(CaptureError):
    """The camera refuses a setting."""

    code = 103


class FrameTimeout(CaptureError):
    """No image before the deadline."""

    code = 104


class FrameIncomplete(CaptureError):
    """Lost packets, short or scrambled data."""

    code = 105


class PairingError(CaptureError):
    """Two frames that do not belong to one exposure."""

    code = 106


class CameraRestarted(CameraUnreachable):
    """It answers, but the control privilege is lost: it was restarted, or gave up the connection."""

    code = 107


class WrongCamera(CameraSetupError):
    """The serial number is not the configured one: cables or addresses were swapped."""

    code = 108


class FrameRepeated(PairingError):
    """A frame with the number of an earlier one."""

    code = 109


class FrameFrozen(PairingError):
    """A frame with a new number, but the previous picture in every pixel."""

    code = 110


class FrameUnpaired(PairingError):
    """One camera exposed and the other did not, or not within the limit."""

    code = 111


class StreamStalled(FrameTimeout):
    """No image several times in a row, though the camera answers."""

    code = 112


class ExposuresDiffer(PairingError):
    """Something moved, or the light changed, between the two exposures of one cycle."""

    code = 113


class CommandRefused(EdgedError):
    """A command that cannot be accepted now; the reason is the message."""


class BeingSetUp(CommandRefused):
    """The cell is in SETUP."""


class TaskFailed(EdgedError):
    """Long work that ended without a result: its process was killed, or it has a bug."""


class TaskTooLarge(TaskFailed):
    """Long work that took more memory or processor time than a task may; the message has the limit."""


class RegressionNeeded(EdgedError):
    """A job or rig that makes recorded cycles worse, or was not tried on them: a person must sign for it.

    cycles : number of recorded cycles that it concerns. good_to_bad : those that became bad; None: not tried.
    regression : id of the trial. params : all of these.
    """

    def __init__(self, cycles: int, good_to_bad: int | None, regression: str | None) -> None:
        self.params = {"cycles": cycles, "good_to_bad": good_to_bad, "regression": regression}
        if good_to_bad is None:
            what = (
                f"it was not tried on the {cycles} recorded cycles that it concerns: try it, or sign why not"
            )
        else:
            what = f"{good_to_bad} recorded cycles that were good are bad by it: look at them, and sign why"
        super().__init__(what)


class LinkError(EdgedError):
    """The link between the cell and its page is closed, of another version, or had an invalid message."""


class SetupRefused(EdgedError):
    """SETUP cannot be entered now, or has ended; the reason is the message."""


class ListenError(EdgedError):
    """A server socket that cannot be opened (port in use, no permission)."""


class PlcFault(EdgedError):
    """A PLC whose memory cannot be read or written. code : names the step that failed, for the log."""

    def __init__(self, message: str, code: str) -> None:
        self.code = code
        super().__init__(printable(message))


class TookTooLong(ListenError):
    """A server that has not started, or ended, within its time. It may do so later."""


@contextmanager
def translated(kind: Callable[[str], EdgedError], what: str) -> Iterator[None]:
    """Convert an `OSError` raised inside to an `EdgedError` whose message begins with `what`."""
    try:
        yield
    except OSError as error:
        raise kind(f"{what}: {error.strerror or error}") from error
