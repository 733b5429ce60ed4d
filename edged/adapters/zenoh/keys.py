"""Zenoh keys of a cell: every key below `edged/<cell>`, and the parameters of a trigger."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

PREFIX = "edged"


@dataclass(frozen=True, slots=True)
class Key:
    """One key.

    path : below `edged/<cell>`.  kind : "kept" is published, and late joiners get the last message.
    message : its definition in the schema, without "_message"; "" if it is not a message.
    """

    path: str
    kind: Literal["published", "kept", "queryable", "token"]
    message: str
    help: str


KEYS = (
    Key("target", "kept", "target", "each cycle: what was measured, or why not"),
    Key("state", "kept", "state", "the daemon's state, on change"),
    Key("health", "published", "health", "every second: rates, ages, counters"),
    Key("alive", "token", "", "gone when the daemon or its link is"),
    Key("preview/left", "published", "", "JPEG, 640 px, at most 5 a second, while somebody listens"),
    Key("preview/right", "published", "", "the same of the right camera"),
    Key(
        "trigger",
        "queryable",
        "target",
        "measure now; replies with the result; to `change_job` with a job message, to the commands of a "
        "registration with a registration message",
    ),
    Key("last", "queryable", "target", "the last result and its age"),
    Key("jobs", "queryable", "jobs", "what can be measured"),
    Key("config", "queryable", "config", "version, configuration, calibration, fingerprint"),
)
QUERYABLES = tuple(key.path for key in KEYS if key.kind == "queryable")

TRIGGER_PARAMETERS = {
    "kind": (
        "locate",
        "locate, change_job, grab, verify or golden; hand_eye_start, touch_start, register_add or "
        "register_solve",
    ),
    "job": (
        "0",
        "number of the job; 0: the active one; all: each is tried, the part that agrees best counts",
    ),
    "timeout_s": ("", "seconds until the reply is an error, up to 60; left out: `zenoh.trigger_timeout_s`"),
    "flange": (
        "",
        "X,Y,Z,QW,QX,QY,QZ (mm; scalar first): where the flange is, if the robot carries the cameras, and "
        "for register_add",
    ),
    "nonce": ("", "anything: the MAC of the answer is over all parameters, so no former answer fits"),
}
"""Default and description of each parameter, by name."""
