"""Faults of a virtual GigE Vision camera, and quirks of its firmware."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


@dataclass(slots=True)
class Faults:
    """Injected faults; may be changed while the camera runs.

    unplugged : the cable is out: nothing is received or sent.
    stalled : triggers are accepted, but no image is sent. delay_s : delay of every image.
    drop_next : number of following images that are not sent.
    frozen : the sensor delivers its last image again and again. repeat_id : the block id does not change.
    packet_loss : share of stream packets that are not sent, including resent ones.
    lost_packets : packets with these numbers (0 is the leader) are not sent until a resend is requested.
    no_resend : resend requests are ignored.
    reordering : share of packets that are sent after the following one.
    duplication : share of packets that are sent twice.
    answer_loss : share of answers to commands that are not sent. answer_delay_s : delay of answers.
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
    """Firmware peculiarities that clients must cope with."""

    MODE_BEFORE_SOURCE = "mode-before-source"
    """A TriggerSource written while TriggerMode is Off is acknowledged but ignored."""
    SOURCE_CLEARS_MODE = "source-clears-mode"
    """Writing TriggerSource switches TriggerMode off."""
    CLAMPED_EXPOSURE = "clamped-exposure"
    """Exposure times above 10 ms are acknowledged but clamped to 10 ms, whatever the XML says."""
    EXPOSURE_TIME_ABS = "exposure-time-abs"
    """The node of the exposure time has its old name, ExposureTimeAbs."""
    LOCKED_EXPOSURE = "locked-exposure"
    """Exposure time and gain cannot be written during acquisition."""
    OLD_CHUNKS = "old-chunks"
    """Chunk data use the payload type of GigE Vision 1.2, from which many clients read only the image."""
    LATE_EXPOSURE = "late-exposure"
    """Exposure time and gain written during acquisition take effect one exposure late."""
    BUSY_DROPS = "busy-drops"
    """A software trigger during an exposure and its read-out is acknowledged but ignored."""
    BUSY_REFUSES = "busy-refuses"
    """A software trigger during an exposure and its read-out is refused: GEV_STATUS_BUSY."""
    COUNTER_RESTARTS = "counter-restarts"
    """The block id silently restarts at 1 after 200 blocks."""
    BLOCK_ID_ZERO = "block-id-zero"
    """Block ids start at 0, which the standard reserves for test packets, and wrap to it after 65535."""
    EXTENDED_IDS = "extended-ids"
    """64-bit block ids, from 2**32 on, and 32-bit packet ids: GigE Vision 2."""
    JPEG_PAYLOAD = "jpeg-payload"
    """Blocks of payload type 6, JPEG, instead of images."""
    SHORT_HEARTBEAT = "short-heartbeat"
    """The heartbeat time-out is 0.5 s at power-on."""
    FEW_NODES = "few-nodes"
    """No frame rate, temperature, lines, actions, chunks or PTP."""


CLAMPED_EXPOSURE_US = 10_000.0
BLOCKS_TO_RESTART = 200
