"""Packets of the GigE Vision stream protocol (GVSP, specification 2.0, chapter 23)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

LEADER, TRAILER, PAYLOAD = 1, 2, 3
IMAGE, IMAGE_WITH_CHUNKS, EXTENDED_CHUNK, JPEG = 0x0001, 0x4001, 0x0005, 0x0006
"""Chunk data follow an image as in 2.0 (bit 14 of the type), or use 1.2's own payload type."""


EXTENDED, EXTENDED_BYTES = 0x80, 12
"""Flag of a header with extended ids, and its additional bytes (GigE Vision 2.0, 24.3)."""


@dataclass(frozen=True, slots=True)
class ImageBlock:
    """One image to be sent.

    ticks : time stamp. pixel_format : PFNC code. data : the image's bytes, followed by chunk data.
    packet_bytes : bytes of data in each packet. payload_type : `IMAGE` or another. extended : 64-bit block
    ids and 32-bit packet ids.
    """

    block_id: int
    ticks: int
    pixel_format: int
    width: int
    height: int
    offset: tuple[int, int]
    data: bytes
    packet_bytes: int
    payload_type: int = IMAGE
    extended: bool = False

    @property
    def packets(self) -> int:
        """Number of payload packets, which are numbered from 1; the leader is 0, the trailer is last."""
        return -(-len(self.data) // self.packet_bytes)


def with_chunks(image: bytes, image_id: int, chunks: Sequence[tuple[int, bytes]]) -> bytes:
    """Pack the image and other chunks (id, content); each content is followed by its id and length."""
    return b"".join(
        part
        for chunk_id, content in ((image_id, image), *chunks)
        for part in (content, struct.pack(">II", chunk_id, len(content)))
    )


def packet(block: ImageBlock, number: int) -> tuple[bytes, ...]:
    """Parts of the packet with this number, 0 to `block.packets` + 1, to be sent as one datagram."""
    if number == 0:
        return (_leader(block),)
    if number > block.packets:
        return (_trailer(block),)
    start = (number - 1) * block.packet_bytes
    return _header(block, PAYLOAD, number), block.data[start : start + block.packet_bytes]


def _header(block: ImageBlock, kind: int, number: int) -> bytes:
    if block.extended:
        return struct.pack(">HHIQI", 0, 0, (EXTENDED | kind) << 24, block.block_id, number)
    return struct.pack(">HHI", 0, block.block_id, kind << 24 | number)


def _leader(block: ImageBlock) -> bytes:
    """Leader packet: payload type, time stamp, pixel format and region."""
    image = (block.pixel_format, block.width, block.height, *block.offset, 0, 0)
    time_stamp = (block.ticks >> 32 & 0xFFFFFFFF, block.ticks & 0xFFFFFFFF)
    kind = block.payload_type
    return _header(block, LEADER, 0) + struct.pack(">HHIIIIIIIHH", 0, kind, *time_stamp, *image)


def _trailer(block: ImageBlock) -> bytes:
    """Trailer packet: number of lines and, with chunk data, their size and layout."""
    lines = struct.pack(">HHI", 0, block.payload_type, block.height)
    chunks = b"" if block.payload_type == IMAGE else struct.pack(">II", len(block.data), 0)
    return _header(block, TRAILER, block.packets + 1) + lines + chunks
