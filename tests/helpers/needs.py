"""Marks of tests that cannot run without something that this machine may lack."""

from __future__ import annotations

import shutil

import pytest


def needs(program: str) -> pytest.MarkDecorator:
    """Skip where a program is not installed."""
    return pytest.mark.skipif(shutil.which(program) is None, reason=f"no {program}")


def needs_aravis() -> pytest.MarkDecorator:
    """Skip where no camera can be reached, with the reason."""
    from edged.adapters.aravis import aravis_missing  # loads GLib

    return pytest.mark.skipif(bool(aravis_missing()), reason=aravis_missing() or "Aravis is there")
