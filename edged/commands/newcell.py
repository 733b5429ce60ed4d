"""Configuration for a new cell, written where there is none."""

from __future__ import annotations

import logging
from pathlib import Path

from edged.app.discovery import CameraInfo, aravis_missing, list_cameras
from edged.config.chosencameras import UNCHOSEN
from edged.domain.arrays import SIDES
from edged.errors import UserError, translated
from edged.files.private import write_private

log = logging.getLogger(__name__)

NAME = "cell.toml"
TEXT = """\
# Written by `edged run` for a cell that knew nothing yet. Cameras, calibration, jobs, robot and PLC are
# set up on its page. What else may stand here: docs/reference/configuration.md
[cell]
name = "cell1"
rig = "rig.json"
jobs = "jobs"

[cameras]
source = "aravis"

[cameras.left]
device = "{left}"

[cameras.right]
device = "{right}"

[modbus]
port = 1502             # 502 is root's

[recorder]
folder = "{recordings}"   # why a cycle failed yesterday

[web]
commissioning = true
"""


def config_in(place: Path) -> Path:
    """Return the configuration of a place: the file itself, or a folder's `cell.toml`, written if missing.

    A missing file is a mistake, not a new cell. Raises `UserError` if the file cannot be written.
    """
    if not place.is_dir():
        return place
    path = place / NAME
    if path.exists():
        return path
    cameras = [] if aravis_missing() else list_cameras()
    with translated(UserError, f"{path}: cannot be written"):
        write_private(path, new_cell(cameras).encode())
    log.warning("%s was written: %d camera(s) found, and all else is set up on the page", path, len(cameras))
    return path


def new_cell(cameras: list[CameraInfo], recordings: str = "recordings") -> str:
    """Return the file's text.

    Exactly two cameras are entered as left and right, until waving a hand before one shows which is which;
    otherwise a person chooses. recordings : their folder; `tools/install` asks for another one.

    >>> 'device = "to-be-chosen-left"' in new_cell([])
    True
    """
    names = [camera.serial or camera.address for camera in cameras]
    is_plain = len(names) == len(SIDES) and all(name.isascii() and name.isalnum() for name in names)
    chosen = dict(zip(SIDES, names, strict=True)) if is_plain else dict(UNCHOSEN)
    return TEXT.format(**chosen, recordings=recordings)
