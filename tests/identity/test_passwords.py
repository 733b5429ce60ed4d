"""Hashes of passwords: what they tell, and what not."""

from __future__ import annotations

import pytest

from edged.identity.passwords import hash_password, is_password

PASSWORD = "correct horse"


@pytest.mark.slow
def test_only_the_password_itself_fits_its_hash() -> None:
    """Not another one, nor the hash."""
    hashed = hash_password(PASSWORD)

    assert is_password(hashed, PASSWORD)
    assert not is_password(hashed, "correct hors")
    assert not is_password(hashed, hashed)


@pytest.mark.slow
def test_two_hashes_of_one_password_differ() -> None:
    """Each has a salt: nobody sees who has the same password."""
    assert hash_password(PASSWORD) != hash_password(PASSWORD)


def test_a_password_in_the_clear_is_no_hash() -> None:
    """It fits nothing, itself included."""
    assert not is_password(PASSWORD, PASSWORD)


def test_a_new_hash_leaves_the_cell_its_cores() -> None:
    """One lane, 64 MiB (RFC 9106, 4): a log-in takes one core at a time, whatever the machine has."""
    assert hash_password(PASSWORD).startswith("$argon2id$v=19$m=65536,t=3,p=1$")
