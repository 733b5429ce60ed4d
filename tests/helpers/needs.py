"""Marks that skip tests where the machine lacks a program or library."""

from __future__ import annotations

import shutil

import pytest


def needs(program: str) -> pytest.MarkDecorator:
    """Skip unless a program is installed."""
    return pytest.mark.skipif(shutil.which(program) is None, reason=f"no {program}")


def needs_aravis() -> pytest.MarkDecorator:
    """Skip, with the reason, where no camera can be reached."""
    from edged.adapters.aravis import aravis_missing  # loads GLib

    return pytest.mark.skipif(bool(aravis_missing()), reason=aravis_missing() or "Aravis is there")
