"""Power that fails at a chosen write of this process, after which nothing is written."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

CALLS = ("open", "mkdir", "rename", "replace", "symlink", "link", "unlink", "rmdir", "fsync")


class PowerCut(BaseException):
    """The power is off."""


@dataclass
class Cut:
    """at : number of writes that succeed; -1: all, without counting. count : writes so far."""

    at: int = -1
    count: int = 0


def failing_writes(monkeypatch: pytest.MonkeyPatch) -> Cut:
    """Make the writes of this process fail as the returned cut says."""
    cut = Cut()

    def failing(name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            writes = name != "open" or args[1] & os.O_CREAT
            if writes and cut.at >= 0:
                cut.count += 1
                if cut.count > cut.at:
                    raise PowerCut
            return real(*args, **kwargs)

        return call

    for name in CALLS:
        monkeypatch.setattr(os, name, failing(name, getattr(os, name)))
    return cut
