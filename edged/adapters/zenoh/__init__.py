"""Zenoh: results for other processes, other machines and fleets, and commands from them."""

from edged.adapters.zenoh.publisher import ZenohPublisher
from edged.adapters.zenoh.session import (
    ZenohSettings,
    configured,
    named_files,
    open_session,
    session_config,
    unguarded,
)
