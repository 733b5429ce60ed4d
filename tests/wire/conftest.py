"""Fixtures for every test of pages and protocols."""

import pytest
from argon2 import PasswordHasher


@pytest.fixture(autouse=True)
def cheap(monkeypatch):
    """Make new password hashes cheap; their required cost is tested elsewhere."""
    monkeypatch.setattr("edged.identity.passwords.HASHER", PasswordHasher(1, 512, 1))
