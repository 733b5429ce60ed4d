"""Zenoh sessions: configuration and its checks, opening, readable errors."""

from __future__ import annotations

import json
import ssl
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

import zenoh

from edged.errors import ConfigError, ListenError, UserError

T = TypeVar("T")
Mode = Literal["peer", "client", "router"]
TLS = "transport/link/tls"
SIDES = ("listen", "connect")
MAX_SESSIONS = 64
"""Most remote sessions, three descriptors each; Zenoh's default of 1000 leaves none for PLC and cameras."""
ACCEPT_PENDING, ACCEPT_TIMEOUT_MS = 32, 3000
"""Most connections that have not completed their handshake, and the time allowed for it."""


@dataclass(frozen=True, slots=True)
class ZenohSettings:
    """Settings of a cell on Zenoh.

    mode : None means "router" for a cell that connects to endpoints and "peer" for one that only listens. A
    Zenoh router does not forward between two peers, and peers that it introduces to each other may not reach
    each other; between routers everything is forwarded. A "client" gives up without a peer.
    listen, connect : endpoints such as "tcp/192.168.1.10:7447". There is no multicast scouting.
    config_file : Zenoh's own configuration (JSON5: TLS, access control, ...); its mode, endpoints and
    scouting take precedence over the fields here.
    trigger_timeout_s : how long a trigger without a time-out of its own waits for its result.
    encoding : of all messages and replies; both have the same fields (`cbor.py`).
    shared_key : key that messages are signed with (`seals.py`); None: they only name their session.
    ros2_domain_id : also publish for ROS 2 nodes of this domain (`edged.adapters.zenoh.ros2`).
    """

    cell: str
    listen: tuple[str, ...] = ("tcp/127.0.0.1:7447",)
    connect: tuple[str, ...] = ()
    config_file: Path | None = None
    mode: Mode | None = None
    trigger_timeout_s: float = 5.0
    encoding: Literal["json", "cbor"] = "json"
    ros2_domain_id: int | None = None
    shared_key: bytes | None = field(default=None, repr=False)


def session_config(
    mode: Mode | None, listen: Sequence[str], connect: Sequence[str], config_file: Path | None = None
) -> zenoh.Config:
    """Zenoh configuration with the named endpoints only, without multicast scouting.

    mode : as in `ZenohSettings`. Settings in `config_file` take precedence.
    Raises `ConfigError` that names the file or the endpoints that Zenoh refuses.
    """
    source = str(config_file) if config_file is not None else "zenoh"
    try:
        config = zenoh.Config.from_file(config_file) if config_file is not None else zenoh.Config()
    except zenoh.ZError as error:
        raise ConfigError(source, [plain(error)]) from error
    untouched = zenoh.Config()
    wanted: dict[str, object] = {
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "scouting/multicast/enabled": False,
        # the cache that late joiners read needs time stamps
        "timestamping/enabled": True,
        # a hardened service may not lock memory (CAP_IPC_LOCK), and results are small
        "transport/shared_memory/enabled": False,
        "transport/unicast/max_sessions": MAX_SESSIONS,
        "transport/unicast/accept_pending": ACCEPT_PENDING,
        "transport/unicast/accept_timeout": ACCEPT_TIMEOUT_MS,
    }
    for key, value in wanted.items():
        if config.get_json(key) != untouched.get_json(key):
            continue  # set by the file
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise ConfigError(source, [f"{key.replace('/', '.')}: {value!r}: {plain(error)}"]) from error
    if json.loads(config.get_json("mode")) is None:
        connects = json.loads(config.get_json("connect/endpoints"))
        config.insert_json5("mode", json.dumps(mode or ("router" if connects else "peer")))
    return config


def configured(settings: ZenohSettings) -> zenoh.Config:
    """Configuration of a cell's session, with its certificates checked.

    Raises `ConfigError`, and `ListenError` for certificates and keys that do not fit, so that this is found
    before the previous session is closed.
    """
    config = session_config(settings.mode, settings.listen, settings.connect, settings.config_file)
    tls = json.loads(config.get_json(TLS))
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        for certificate, key in ((tls[f"{side}_certificate"], tls[f"{side}_private_key"]) for side in SIDES):
            if certificate and key:
                context.load_cert_chain(certificate, key)
        if tls["root_ca_certificate"]:
            context.load_verify_locations(tls["root_ca_certificate"])
    except (OSError, ssl.SSLError) as error:
        raise ListenError(f"zenoh: {settings.config_file}: TLS files: {error}") from error
    return config


@dataclass(frozen=True, slots=True)
class ClientTls:
    """PEM files of a client's TLS. certificate, key : the client's own, both or none.

    authority : certificate of the CA by which it verifies a router.
    """

    certificate: Path | None = None
    key: Path | None = None
    authority: Path | None = None


def with_tls(config: zenoh.Config, tls: ClientTls) -> zenoh.Config:
    """Add TLS to a configuration, for endpoints tls/... . Raises `UserError` for files that do not fit."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    names = "certificate and key"
    try:
        if tls.certificate is not None and tls.key is not None:
            names = f"{tls.certificate}, {tls.key}"
            context.load_cert_chain(tls.certificate, tls.key)
        if tls.authority is not None:
            names = str(tls.authority)
            context.load_verify_locations(tls.authority)
    except (OSError, ssl.SSLError) as error:
        reason = getattr(error, "reason", None) or getattr(error, "strerror", None) or error
        raise UserError(f"{names}: {reason}, expected PEM files that belong together") from error
    mutual = tls.certificate is not None
    for name, value in (
        ("root_ca_certificate", tls.authority),
        ("connect_certificate", tls.certificate),
        ("connect_private_key", tls.key),
    ):
        if value is not None:
            config.insert_json5(f"{TLS}/{name}", json.dumps(str(value.absolute())))
    config.insert_json5(f"{TLS}/enable_mtls", json.dumps(mutual))
    return config


def named_files(config_file: Path) -> list[Path]:
    """Existing TLS files that Zenoh's own configuration names: certificates, keys and authorities.

    Raises `ConfigError` for a file that Zenoh cannot read.
    """
    config = session_config(None, (), (), config_file)
    tls = json.loads(config.get_json(TLS))
    return [Path(name) for name in tls.values() if isinstance(name, str) and Path(name).is_file()]


def secret_files(config_file: Path) -> list[Path]:
    """Files with a private key or a password that Zenoh's own configuration names.

    The configuration itself is one if it contains such. Raises `ConfigError` for a file that Zenoh cannot
    read.
    """
    config = session_config(None, (), (), config_file)
    tls, auth = (json.loads(config.get_json(key)) for key in (TLS, "transport/auth"))
    named = [tls[f"{side}_private_key"] for side in SIDES]
    named += [auth["usrpwd"]["dictionary_file"], auth["pubkey"]["private_key_file"]]
    if auth["usrpwd"]["password"] or auth["pubkey"]["private_key_pem"]:
        named.append(str(config_file))
    return [Path(name) for name in dict.fromkeys(named) if name]


def unguarded(
    listen: Sequence[str], connect: Sequence[str], config_file: Path | None = None
) -> list[tuple[str, str]]:
    """Endpoints that admit every peer, each with "listen" or "connect".

    Empty where access control denies by default; endpoints with certificates on both sides are not included.
    Multicast scouting is, as it connects to every answering peer. Raises `ConfigError` for a file that Zenoh
    cannot read.
    """
    config = session_config(None, listen, connect, config_file)
    control = json.loads(config.get_json("access_control"))
    if control["enabled"] and control["default_permission"] == "deny":
        return []
    mutual = json.loads(config.get_json(TLS))["enable_mtls"]
    found = [
        (side, endpoint)
        for side in SIDES
        for endpoint in _endpoints(json.loads(config.get_json(f"{side}/endpoints")))
        if not (mutual and endpoint.startswith(("tls/", "quic/")))
    ]
    if json.loads(config.get_json("scouting/multicast/enabled")):
        found.append(("connect", "scouting/multicast"))
    return found


def _endpoints(value: Any) -> list[str]:
    """All endpoints in a setting, which may also have a list for each mode."""
    if isinstance(value, dict):
        value = [endpoint for endpoints in value.values() for endpoint in endpoints]
    return list(value)


def open_session(config: zenoh.Config) -> zenoh.Session:
    """Open a session. Raises `ListenError` that names the endpoints. Blocks: not for the event loop."""
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        places = (
            f"listen {config.get_json('listen/endpoints')}, connect {config.get_json('connect/endpoints')}"
        )
        raise ListenError(f"zenoh: {plain(error)} ({places})") from error


def plain(error: BaseException) -> str:
    """Zenoh's message without the paths of its source files."""
    return str(error).split(" at /", 1)[0].strip()
