"""Garbage of long-lived processes."""

from __future__ import annotations

import gc


def keep_what_is_loaded() -> None:
    """What is there by now stays, and is not looked through for garbage again and again.

    That holds up the loop: 70 ms for all of a process with its modules, 25 ms for what servers load as they
    start. It came once in a while, with what a viewer of the page leaves behind.
    """
    gc.collect()
    gc.freeze()
    gc.enable()  # a process that imports much has not searched so far
