"""Error messages about the board for commands that take `--board`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from edged.errors import CalibrationError


@contextmanager
def naming_board_option() -> Iterator[None]:
    """Prefix errors about which board the pictures show with the option that states it."""
    try:
        yield
    except CalibrationError as error:
        if error.code not in ("which_board", "other_board"):
            raise
        raise CalibrationError(f"--board: {error}", error.code, **error.params) from None
