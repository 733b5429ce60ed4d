"""Hashes of passwords."""

from __future__ import annotations

import pytest

from edged.identity.passwords import hash_password, is_password

PASSWORD = "correct horse"


@pytest.mark.slow
def test_only_the_password_itself_fits_its_hash() -> None:
    """The password fits its hash; another one, or the hash itself, does not."""
    hashed = hash_password(PASSWORD)

    assert is_password(hashed, PASSWORD)
    assert not is_password(hashed, "correct hors")
    assert not is_password(hashed, hashed)


@pytest.mark.slow
def test_two_hashes_of_one_password_differ() -> None:
    """Two hashes of one password differ, because each has a salt."""
    assert hash_password(PASSWORD) != hash_password(PASSWORD)


def test_a_password_in_the_clear_is_no_hash() -> None:
    """A password in clear text is no hash and fits nothing."""
    assert not is_password(PASSWORD, PASSWORD)


def test_a_new_hash_leaves_the_cell_its_cores() -> None:
    """A new hash has one lane and 64 MiB (RFC 9106, 4), so a log-in takes one core."""
    assert hash_password(PASSWORD).startswith("$argon2id$v=19$m=65536,t=3,p=1$")
