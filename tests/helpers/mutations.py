"""Corrupted messages for fuzz tests."""

from __future__ import annotations

import random


def mutated(message: bytes, chance: random.Random) -> bytes:
    """Change, drop or duplicate a few of its bytes."""
    data = bytearray(message)
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(data))
        match chance.randrange(4):
            case 0:
                data[at] ^= 1 << chance.randrange(8)
            case 1:
                data[at:at] = chance.randbytes(chance.randint(1, 8))
            case 2:
                del data[at : at + chance.randint(1, 8)]
            case _:
                data[at] = chance.randrange(256)
        if not data:
            return b"\0"
    return bytes(data)
