"""Section for publication over Zenoh: its endpoints, and permission to command over them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from edged.config.fields import FilePath, Section, is_loopback

INTERNET = ("tcp", "tls", "udp", "quic", "ws")
PROTOCOLS = (*INTERNET, "serial", "unixsock-stream", "unixpipe", "vsock")
"""Protocols of Zenoh endpoints."""


def _endpoint(value: str) -> str:
    protocol, _, address = value.partition("/")
    if not protocol or not address or ":" in protocol:
        raise ValueError("expected PROTOCOL/ADDRESS, for example tcp/192.168.10.20:7447")
    if "private_key_base64" in value:  # endpoints are shown, and published
        raise ValueError("a private key does not belong in an endpoint: name its file in zenoh.config_file")
    return value


def tcp_port(endpoint: str) -> int | None:
    """TCP port of a listening endpoint; None if it has none."""
    found = re.match(r"(?:tcp|tls|ws)/[^?#]*:([0-9]{1,5})(?:[?#]|$)", endpoint)
    return None if found is None else int(found[1])


def check_endpoint(endpoint: str) -> None:
    """Check that an endpoint can be connected to. Raises `ValueError`."""
    _endpoint(endpoint)
    protocol = endpoint.partition("/")[0]
    if protocol not in PROTOCOLS:
        raise ValueError(f"expected one of {', '.join(PROTOCOLS)} before the /")
    if protocol in INTERNET and not re.search(r"/[^?#]+:[0-9]{1,5}(?:[?#]|$)", endpoint):
        raise ValueError(f"expected {protocol}/HOST:PORT; the port is usually 7447")


def is_local(endpoint: str) -> bool:
    """Whether a Zenoh endpoint connects within this machine only."""
    protocol, _, rest = endpoint.partition("/")
    host, _, _ = re.split("[?#]", rest, maxsplit=1)[0].rpartition(":")
    return protocol in ("unixsock-stream", "unixpipe") or is_loopback(host.strip("[]"))


Endpoint = Annotated[str, AfterValidator(_endpoint)]


class ZenohSection(Section):
    """Publication to other processes."""

    enabled: bool = Field(True, description="publish at all")
    listen: list[Endpoint] = Field(
        default_factory=lambda: ["tcp/127.0.0.1:7447"], description="endpoints that others connect to"
    )
    connect: list[Endpoint] = Field(
        default_factory=list, description='endpoints to connect to: a fleet\'s router, "tls/192.168.1.5:7447"'
    )
    config_file: FilePath | None = Field(None, description="Zenoh's own configuration: TLS, access control")
    commands: Literal["guarded", "anyone", "refused"] = Field(
        "guarded",
        description='who may trigger and change the job: "guarded": this machine, and beyond it those whom '
        '`config_file` lets in by mutual TLS or access control; "anyone" who can connect; "refused": nobody, '
        "the cell is read-only here",
    )
    encoding: Literal["json", "cbor"] = Field(
        "json", description="of all messages: the same fields, in CBOR fewer bytes"
    )
    shared_key: FilePath | None = Field(
        None,
        description="file with a secret of 32 bytes or more, with which messages are signed: receivers that "
        "have it recognise forged ones",
    )
    trigger_timeout_s: float = Field(
        5.0, gt=0, le=60, description="how long a trigger waits for its result that does not say so itself"
    )
    ros2_domain_id: int | None = Field(
        None, ge=0, le=232, description="publish poses for ROS 2 (rmw_zenoh) too"
    )

    @model_validator(mode="after")
    def _guarded(self) -> ZenohSection:
        if self.config_file is None:  # otherwise it is checked where that file is read
            self.refuse_unguarded([("listen", end) for end in self.listen])
            self.refuse_unguarded([("connect", end) for end in self.connect])
        return self

    def refuse_unguarded(self, endpoints: Sequence[tuple[str, str]]) -> None:
        """Raise `ValueError` if commands could come from other machines over one of the endpoints.

        endpoints : ("listen" or "connect", endpoint) of those not guarded by mutual TLS or access control.
        """
        for side, endpoint in endpoints:
            if self.enabled and self.commands == "guarded" and not is_local(endpoint):
                raise ValueError(
                    f"{side}: over {endpoint} other machines could trigger and change the job: set "
                    "zenoh.config_file with mutual TLS or access control (config/zenoh-acl-example.json5), "
                    'or zenoh.commands = "refused" for readers only, or "anyone" where everybody there may'
                )
