"""Passwords of the status page and of OPC UA: Argon2 hashes (RFC 9106), as `edged password` makes them."""

from __future__ import annotations

from argon2 import PasswordHasher
from argon2.exceptions import Argon2Error, InvalidHashError

HASHER = PasswordHasher(time_cost=3, memory_cost=64 * 1024, parallelism=1)
"""The second recommended option of RFC 9106, 4 (64 MiB), in one lane: the other cores are the cell's."""


def hash_password(password: str) -> str:
    """The hash for a `password_hash`; slow on purpose, each call with another salt."""
    return HASHER.hash(password)


def is_password(password_hash: str, password: str) -> bool:
    """Whether the hash was made of this password; False also for what is no hash. As slow as hashing."""
    try:
        return HASHER.verify(password_hash, password)
    except (Argon2Error, InvalidHashError):
        return False
