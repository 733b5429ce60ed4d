"""What a page may ask of the cell. Everything in it is hostile until it is read here."""

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
"""Size of a message of a page: the note of a release is the largest."""
BOUNDS = CborBounds(MAX_BYTES, 2000, 32)

BesideRig = Literal["marks", "acceptance"]
Token = Annotated[str, StringConstraints(min_length=1, max_length=64)]
Name = Annotated[str, StringConstraints(min_length=1, max_length=64)]


class Request(BaseModel):
    """A message of a page: nothing else, of the very types, every text with a bound."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


Message = TypeVar("Message", bound=Request)


class EnterSetup(Request):
    """Take the cell for SETUP; answered by the lease's token."""

    ask: Literal["enter"] = "enter"
    name: Name
    take_over: bool = False


class RenewLease(Request):
    """Extend the lease."""

    ask: Literal["renew"] = "renew"
    token: Token


class LeaveSetup(Request):
    """Give the cell back."""

    ask: Literal["leave"] = "leave"
    token: Token


class EndSetup(Request):
    """End SETUP for its holder. name : of the person who says so."""

    ask: Literal["end"] = "end"
    name: Name


class TakePair(Request):
    """One exposure; answered by a pair."""

    ask: Literal["capture"] = "capture"
    token: Token


class AdjustCamera(Request):
    """Set the stated values of a camera on trial; answered by its `CameraValues`."""

    ask: Literal["adjust"] = "adjust"
    token: Token
    side: Side
    exposure_us: float | None = None
    gain_db: float | None = None


class ReadLimits(Request):
    """Answered by the `CameraLimits` of a camera."""

    ask: Literal["limits"] = "limits"
    token: Token
    side: Side


class TryCameras(Request):
    """Use other cameras until SETUP ends."""

    ask: Literal["try_cameras"] = "try_cameras"
    token: Token
    changes: dict[Side, ChosenCamera]


class InstallRelease(Request):
    """Run by other files: those of the archive that comes with it as sealed memory (`edged.link.memory`).

    token : of the lease, where somebody has the cell. author, note : whose it is, and why.
    """

    ask: Literal["install"] = "install"
    token: Token | None = None
    author: Name
    note: Annotated[str, StringConstraints(max_length=2500)]


class TakeJob(Request):
    """Measure by the job with a number, where no PLC owns the right to write."""

    ask: Literal["take_job"] = "take_job"
    number: Annotated[int, Field(ge=1, le=65535)]


class KeepGolden(Request):
    """Measure, and keep where the part of a job lies, where no PLC owns the right to write."""

    ask: Literal["keep_golden"] = "keep_golden"
    number: Annotated[int, Field(ge=1, le=65535)]


class KeepBeside(Request):
    """Have another file beside the rig, which comes with it as sealed memory: marks, or an acceptance."""

    ask: Literal["keep_beside"] = "keep_beside"
    token: Token
    what: BesideRig


class AskRegisters(Request):
    """Answered by the address and value of each register."""

    ask: Literal["registers"] = "registers"


class AskExchanges(Request):
    """Answered by the last `Exchange`s of a PLC."""

    ask: Literal["exchanges"] = "exchanges"


class AskMetrics(Request):
    """Answered by Prometheus' text."""

    ask: Literal["metrics"] = "metrics"


class Examine(Request):
    """Examine the machine; answered by a list of findings, as `edged doctor --json` has them."""

    ask: Literal["examine"] = "examine"


class Mend(Request):
    """Do what a finding needs: read the files again, or take those with secrets from other users."""

    ask: Literal["mend"] = "mend"
    what: Literal["reload", "secrets"]


class OnStage(Request):
    """A request to the stage before virtual cameras. route : of its handler; body : of it.

    Answered by `answer`, a document, or `problem`: its status, code and detail.
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
    """A request with its number, by which it is answered."""

    number: Annotated[int, Field(ge=1, lt=2**53)]
    request: Annotated[Asked, Field(discriminator="ask")]


class Greeting(Request):
    """The first message of either end."""

    edged: Annotated[str, StringConstraints(max_length=64)]
    schema_id: Annotated[str, StringConstraints(max_length=64)]

    def check(self, who: str) -> None:
        """Raises `LinkError` that names a version other than this one's. who : the other end."""
        if self != GREETING:
            raise LinkError(
                f"{who} is edged {self.edged} (schema {self.schema_id}), this is edged {GREETING.edged} "
                f"(schema {GREETING.schema_id}): start both anew"
            )


GREETING = Greeting(edged=__version__, schema_id=schema_of(Envelope))


def encoded(message: Envelope | Greeting) -> bytes:
    """A page's message."""
    return encode_cbor(message.model_dump(mode="json"))


def envelope_of(data: bytes) -> Envelope:
    """A page's request. Raises `LinkError` for anything else."""
    return _read(Envelope, data)


def greeting_of(data: bytes) -> Greeting:
    """The first message. Raises `LinkError`."""
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
