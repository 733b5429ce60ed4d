"""Requests that a page may send to the cell. Their content is untrusted until it is validated here."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from edged import __version__
from edged.cbor import CborBounds, decode_cbor, encode_cbor
from edged.config.chosencameras import ChosenCamera
from edged.domain.arrays import Side
from edged.errors import LinkError
from edged.link.values import schema_of

MAX_BYTES = 64 * 1024
"""Maximum size of a page's message: the note of a release is the largest."""
BOUNDS = CborBounds(MAX_BYTES, 2000, 32)

BesideRig = Literal["marks", "acceptance"]
Token = Annotated[str, StringConstraints(min_length=1, max_length=64)]
Name = Annotated[str, StringConstraints(min_length=1, max_length=64)]


class Request(BaseModel):
    """Base of a page's messages: no extra fields, exact types, and bounded strings."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


Message = TypeVar("Message", bound=Request)


class EnterSetup(Request):
    """Take the cell for SETUP; answered with the lease's token."""

    ask: Literal["enter"] = "enter"
    name: Name
    take_over: bool = False


class RenewLease(Request):
    """Extend the lease."""

    ask: Literal["renew"] = "renew"
    token: Token


class LeaveSetup(Request):
    """End the lease of the cell."""

    ask: Literal["leave"] = "leave"
    token: Token


class EndSetup(Request):
    """End SETUP on behalf of its holder. name : of the person who requests it."""

    ask: Literal["end"] = "end"
    name: Name


class TakePair(Request):
    """Make one exposure; answered with a pair of images."""

    ask: Literal["capture"] = "capture"
    token: Token


class AdjustCamera(Request):
    """Set the given values of a camera on trial; answered with its `CameraValues`."""

    ask: Literal["adjust"] = "adjust"
    token: Token
    side: Side
    exposure_us: float | None = None
    gain_db: float | None = None


class ReadLimits(Request):
    """Read the limits of a camera; answered with its `CameraLimits`."""

    ask: Literal["limits"] = "limits"
    token: Token
    side: Side


class TryCameras(Request):
    """Use other cameras until SETUP ends."""

    ask: Literal["try_cameras"] = "try_cameras"
    token: Token
    changes: dict[Side, ChosenCamera]


class InstallRelease(Request):
    """Use other files: those of the archive that comes with it as sealed memory (`edged.link.memory`).

    token : of the lease, if the cell is taken for SETUP. author, note : who installs it and why, for the log.
    """

    ask: Literal["install"] = "install"
    token: Token | None = None
    author: Name
    note: Annotated[str, StringConstraints(max_length=2500)]


class TakeJob(Request):
    """Make the job with this number the active one, if no PLC holds the right to write."""

    ask: Literal["take_job"] = "take_job"
    number: Annotated[int, Field(ge=1, le=65535)]


class KeepGolden(Request):
    """Measure, and store the part of a job as its golden part, if no PLC holds the right to write."""

    ask: Literal["keep_golden"] = "keep_golden"
    number: Annotated[int, Field(ge=1, le=65535)]


class KeepBeside(Request):
    """Replace a file beside the rig, which comes with it as sealed memory: marks, or an acceptance test."""

    ask: Literal["keep_beside"] = "keep_beside"
    token: Token
    what: BesideRig


class AskRegisters(Request):
    """Read the registers; answered with the address and value of each."""

    ask: Literal["registers"] = "registers"


class AskExchanges(Request):
    """Read the last exchanges with a PLC; answered with `Exchange`s."""

    ask: Literal["exchanges"] = "exchanges"


class AskMetrics(Request):
    """Read the metrics; answered with text for Prometheus."""

    ask: Literal["metrics"] = "metrics"


class Examine(Request):
    """Examine the machine; answered with a list of findings, as in `edged doctor --json`."""

    ask: Literal["examine"] = "examine"


class Mend(Request):
    """Fix a finding: reload the files, or make those with secrets inaccessible to other users."""

    ask: Literal["mend"] = "mend"
    what: Literal["reload", "secrets"]


class OnStage(Request):
    """Request to the stage in front of virtual cameras. route : of its handler; body : of the request.

    Answered with `answer`, a document, or `problem`: its status, code and detail.
    """

    ask: Literal["stage"] = "stage"
    route: Annotated[str, StringConstraints(max_length=64)]
    body: dict[str, Any]


Asked = (
    EnterSetup
    | RenewLease
    | LeaveSetup
    | EndSetup
    | TakePair
    | AdjustCamera
    | ReadLimits
    | TryCameras
    | InstallRelease
    | TakeJob
    | KeepGolden
    | KeepBeside
    | AskRegisters
    | AskExchanges
    | AskMetrics
    | Examine
    | Mend
    | OnStage
)


class Envelope(Request):
    """Request with its number, which its answer repeats."""

    number: Annotated[int, Field(ge=1, lt=2**53)]
    request: Annotated[Asked, Field(discriminator="ask")]


class Greeting(Request):
    """First message of either end."""

    edged: Annotated[str, StringConstraints(max_length=64)]
    schema_id: Annotated[str, StringConstraints(max_length=64)]

    def check(self, who: str) -> None:
        """Raise `LinkError`, with both versions, if they differ. who : the other end, for the message."""
        if self != GREETING:
            raise LinkError(
                f"{who} is edged {self.edged} (schema {self.schema_id}), this is edged {GREETING.edged} "
                f"(schema {GREETING.schema_id}): start both anew"
            )


GREETING = Greeting(edged=__version__, schema_id=schema_of(Envelope))


def encoded(message: Envelope | Greeting) -> bytes:
    """Encode a message."""
    return encode_cbor(message.model_dump(mode="json"))


def envelope_of(data: bytes) -> Envelope:
    """Decode a page's request. Raises `LinkError` for anything else."""
    return _read(Envelope, data)


def greeting_of(data: bytes) -> Greeting:
    """Decode the first message. Raises `LinkError`."""
    return _read(Greeting, data)


def _read(model: type[Message], data: bytes) -> Message:
    try:
        return model.model_validate(decode_cbor(data, BOUNDS))
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"]))
        raise LinkError(f"no message: {place[:100]}: {first['msg'][:200]}") from error
    except (ValueError, RecursionError) as error:
        raise LinkError(f"no message: {str(error)[:200]}") from error
