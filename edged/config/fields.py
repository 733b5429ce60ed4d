"""Common field types of the sections, and their base class, which refuses unknown keys."""

from __future__ import annotations

import ipaddress
import re
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, SecretStr, ValidationInfo

from edged.domain.numerals import is_whole


def _beside_the_file(value: object, info: ValidationInfo) -> object:
    """Resolve relative paths against the configuration file's folder, not the working directory."""
    if isinstance(value, str) and value and info.context is not None:
        try:
            return Path(info.context["directory"]) / Path(value).expanduser()
        except RuntimeError as error:  # "~nobody"
            raise ValueError(str(error)) from None
    return value


FilePath = Annotated[Path, BeforeValidator(_beside_the_file)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
Port = Annotated[int, Field(ge=1, le=65535)]
WebAddress = Annotated[str, Field(pattern=r"^https?://[^\s/]\S*$", max_length=500)]


def _network(value: str) -> str:
    ipaddress.ip_network(value)  # ValueError names what is wrong
    return value


Network = Annotated[str, AfterValidator(_network)]


def _address(value: str) -> str:
    ipaddress.ip_address(value)  # ValueError names what is wrong
    return value


Address = Annotated[str, AfterValidator(_address)]


def _host(value: str) -> str:
    host, colon, port = value.rpartition(":")
    if colon and (":" not in host or host.endswith("]")) and is_whole(port):
        raise ValueError(
            f'expected an address alone, the port is another key: host = "{host}" and port = {port}'
        )
    if "//" in value or any(c.isspace() for c in value):
        raise ValueError('expected an address, for example "0.0.0.0" or "localhost"')
    return value


Host = Annotated[str, Field(min_length=1), AfterValidator(_host)]

_ARGON2 = re.compile(
    r"\$argon2(?:id|i|d)\$(?:v=[0-9]{2}\$)?m=([0-9]{1,10}),t=([0-9]{1,10}),p=([0-9]{1,10})"
    r"\$([A-Za-z0-9+/]{11,86})\$([A-Za-z0-9+/]{22,86})"
)
"""An encoded hash: cost, salt of 8 to 64 bytes, hash of 16 to 64 (RFC 9106, 3.1 recommends 16 and 32)."""
MAX_MEMORY_KIB, MAX_PASSES, MAX_LANES = 256 * 1024, 16, 4
"""Maximum cost of a hash that is accepted: one from elsewhere must not exhaust memory or processor."""
HASH_LEFT_OUT = "$argon2-left-out"
"""Replaces a password hash in a configuration that is passed on: it stays valid, but no password matches."""


def check_password_hash(text: str) -> str:
    """Return an Argon2 hash of acceptable cost. Raises `ValueError`, whose text does not contain the hash."""
    found = _ARGON2.fullmatch(text)
    if found is None:
        raise ValueError("expected an Argon2 hash, as `edged password` prints it")
    memory_kib, passes, lanes = (int(number) for number in found.groups()[:3])
    if memory_kib > MAX_MEMORY_KIB or passes > MAX_PASSES or lanes > MAX_LANES:
        raise ValueError(
            f"this hash costs more than {MAX_MEMORY_KIB} KiB, {MAX_PASSES} passes and {MAX_LANES} lanes"
        )
    return text


def _password_hash(value: SecretStr) -> SecretStr:
    if value.get_secret_value() not in ("", HASH_LEFT_OUT):
        check_password_hash(value.get_secret_value())
    return value


PasswordHash = Annotated[SecretStr, AfterValidator(_password_hash)]


class Section(BaseModel):
    """Table of the file: unknown keys and values of another type are mistakes."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


def is_loopback(host: str) -> bool:
    """Whether an address can be reached from this machine only."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def is_address(device: str) -> bool:
    """Whether a camera is named by its IP address, rather than its serial number."""
    try:
        ipaddress.ip_address(device)
    except ValueError:
        return False
    return True
