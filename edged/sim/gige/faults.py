"""Faults of a virtual GigE Vision camera, and quirks of its firmware."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


@dataclass(slots=True)
class Faults:
    """Faults; may be changed while the camera runs.

    unplugged : the cable is out: nothing is heard or said.
    stalled : triggers are taken, but no image is sent. delay_s : every image comes so much later.
    drop_next : so many next images are not sent.
    frozen : the sensor delivers its last image again and again. repeat_id : the block id stands still.
    packet_loss : share of stream packets that are not sent (resent ones neither).
    lost_packets : packets of these numbers (0 is the leader) are not sent, but are when asked for again.
    no_resend : requests to send packets again are not heard.
    reordering : share of packets that are sent after the one that follows them.
    duplication : share of packets that are sent twice.
    answer_loss : share of answers to commands that are not sent. answer_delay_s : they come so much later.
    """

    packet_loss: float = 0.0
    unplugged: bool = False
    stalled: bool = False
    delay_s: float = 0.0
    frozen: bool = False
    drop_next: int = 0
    repeat_id: bool = False
    lost_packets: tuple[int, ...] = ()
    no_resend: bool = False
    reordering: float = 0.0
    duplication: float = 0.0
    answer_loss: float = 0.0
    answer_delay_s: float = 0.0


class Quirk(StrEnum):
    """Habits of firmware that clients must live with."""

    MODE_BEFORE_SOURCE = "mode-before-source"
    """A TriggerSource that is written while TriggerMode is Off is acknowledged and forgotten."""
    SOURCE_CLEARS_MODE = "source-clears-mode"
    """Writing TriggerSource switches TriggerMode off."""
    CLAMPED_EXPOSURE = "clamped-exposure"
    """Exposure times above 10 ms are acknowledged and become 10 ms, whatever the description says."""
    EXPOSURE_TIME_ABS = "exposure-time-abs"
    """The exposure time's node has its old name, ExposureTimeAbs."""
    LOCKED_EXPOSURE = "locked-exposure"
    """Exposure time and gain cannot be written while it acquires."""
    OLD_CHUNKS = "old-chunks"
    """Chunk data come in the payload type of GigE Vision 1.2, of which many clients read the image only."""
    LATE_EXPOSURE = "late-exposure"
    """Exposure time and gain that are written while it acquires hold from the exposure after the next on."""
    BUSY_DROPS = "busy-drops"
    """A software trigger during an exposure and its read-out is acknowledged and forgotten."""
    BUSY_REFUSES = "busy-refuses"
    """Such a trigger is refused: GEV_STATUS_BUSY."""
    COUNTER_RESTARTS = "counter-restarts"
    """The block id begins at 1 again after 200 blocks, without a word."""
    BLOCK_ID_ZERO = "block-id-zero"
    """Block ids begin at 0, which the standard keeps for test packets, and come back to it after 65535."""
    EXTENDED_IDS = "extended-ids"
    """Block ids of 64 bits, from 2**32 on, and packet ids of 32: GigE Vision 2."""
    JPEG_PAYLOAD = "jpeg-payload"
    """Blocks of payload type 6, JPEG, instead of images."""
    SHORT_HEARTBEAT = "short-heartbeat"
    """At power-on its heartbeat time-out is 0.5 s."""
    FEW_NODES = "few-nodes"
    """No frame rate, temperature, lines, actions, chunks or PTP."""


CLAMPED_EXPOSURE_US = 10_000.0
BLOCKS_TO_RESTART = 200
