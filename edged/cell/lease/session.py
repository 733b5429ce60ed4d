"""SETUP as the loop does it: one request at a time, the note that a person has the cell, the cameras."""

from __future__ import annotations

import asyncio
import logging
from typing import Protocol

from edged.cell.lease.cameras import SetupCameras
from edged.cell.lease.lease import Request, SetupDesk
from edged.errors import EdgedError
from edged.ports import Head

log = logging.getLogger("edged.cell.cycle")
"""The loop's: whoever searches the journal for it finds these lines, too."""


class Notebook(Protocol):
    """Where it is noted that a person has the cell, so that it is known after the daemon was killed."""

    def is_taken(self) -> bool:
        """Whether somebody has."""
        ...

    def note(self, name: str) -> None:
        """Somebody has. Raises `OSError`; then SETUP is refused."""
        ...

    def clear(self) -> None:
        """Nobody has. Raises `OSError`."""
        ...


class SetupSession:
    """What the loop does for whoever has the cell.

    notebook : None: who has the cell is forgotten with this process.
    """

    def __init__(self, desk: SetupDesk, cameras: SetupCameras, notebook: Notebook | None) -> None:
        self._desk = desk
        self._cameras = cameras
        self._notebook = notebook
        self._is_noted = desk.taken

    async def enter(self, name: str, *, take_over: bool) -> str:
        """Take the cell, also from whoever has it; returns the token when the loop serves it.

        Raises `SetupRefused`.
        """
        has_it = take_over and self._desk.taken
        token = self._desk.take_over(name) if has_it else self._desk.enter(name)

        async def begun() -> None:
            pass

        await self._desk.ask(token, begun)
        return token

    async def serve(self, configured: Head) -> bool:
        """Do one thing that was asked for; False when there is none. Cameras that nobody has are closed."""
        await self._keep_note()
        if not self._desk.taken:
            await self._cameras.put_down(configured)
        request = self._desk.take()
        if request is None:
            return False
        await _carry_out(request)
        return True

    async def end(self, configured: Head) -> None:
        """The cameras are the loop's again."""
        await self._keep_note()
        await self._cameras.put_down(configured)
        self._cameras.hand_back()

    async def stop(self, configured: Head) -> None:
        """The daemon ends: nothing is done for anybody any more, and every camera is closed."""
        self._desk.stop()
        self._cameras.hand_back()
        await self._cameras.put_down(configured)

    async def _keep_note(self) -> None:
        """Note that a person has the cell, or has it no longer. SETUP that cannot be noted ends."""
        if self._notebook is None or self._desk.taken == self._is_noted:
            return
        try:
            if self._desk.taken:
                await asyncio.to_thread(self._notebook.note, self._desk.name)
            else:
                await asyncio.to_thread(self._notebook.clear)
        except OSError as error:
            if self._desk.taken:
                self._desk.end(f"it cannot be noted who has the cell: {error}")
                return
            log.exception("SETUP has ended, but that cannot be noted: after a restart it begins again")
        self._is_noted = self._desk.taken


async def _carry_out(request: Request) -> None:
    try:
        answer = await request.work()
    except EdgedError as error:
        if not request.answer.done():
            request.answer.set_exception(error)
    except BaseException:
        request.answer.cancel()
        raise
    else:
        if not request.answer.done():
            request.answer.set_result(answer)
