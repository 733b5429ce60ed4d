"""Roles, and the visitor who sends a request."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class Role(enum.IntEnum):
    """What somebody may do; each may do what those before it may."""

    VIEWER = 0
    """Look."""
    OPERATOR = 1
    """Run the cell: end SETUP, change jobs, check."""
    ENGINEER = 2
    """Set the cell up."""

    @property
    def word(self) -> str:
        """As it is written in JSON."""
        return self.name.lower()


@dataclass(frozen=True, slots=True)
class Visitor:
    """Who sent a request.

    session : digest of the cookie of a log-in on the page; "" without one, for looking only.
    is_idle : inactive for so long that they may only look until they enter their password again.
    is_confirmed : they entered it just now.
    """

    name: str
    role: Role
    address: str
    session: str = ""
    language: str | None = None
    is_idle: bool = False
    is_confirmed: bool = False
