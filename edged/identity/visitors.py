"""Roles, and the visitor that sends a request."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class Role(enum.IntEnum):
    """Permissions of a visitor; each role includes those before it."""

    VIEWER = 0
    """May view."""
    OPERATOR = 1
    """May run the cell: end SETUP, change jobs, check."""
    ENGINEER = 2
    """May set up the cell."""

    @property
    def word(self) -> str:
        """Name of the role in JSON."""
        return self.name.lower()


@dataclass(frozen=True, slots=True)
class Visitor:
    """Sender of a request.

    session : digest of the session cookie of the page; "" without one, for viewing only.
    is_idle : inactive for so long that they may only view until they enter their password again.
    is_confirmed : they entered it recently.
    """

    name: str
    role: Role
    address: str
    session: str = ""
    language: str | None = None
    is_idle: bool = False
    is_confirmed: bool = False
