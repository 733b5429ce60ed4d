"""Common kinds of values of the sections, and their base class, which refuses unknown keys."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo


def _beside_the_file(value: object, info: ValidationInfo) -> object:
    """Relative paths mean: beside the configuration file, whatever the working directory is."""
    if isinstance(value, str) and value and info.context is not None:
        try:
            return Path(info.context["directory"]) / Path(value).expanduser()
        except RuntimeError as error:  # "~nobody"
            raise ValueError(str(error)) from None
    return value


FilePath = Annotated[Path, BeforeValidator(_beside_the_file)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
Port = Annotated[int, Field(ge=1, le=65535)]


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
    if colon and (":" not in host or host.endswith("]")) and port.isdecimal():
        raise ValueError(
            f'expected an address alone, the port is another key: host = "{host}" and port = {port}'
        )
    if "//" in value or any(c.isspace() for c in value):
        raise ValueError('expected an address, for example "0.0.0.0" or "localhost"')
    return value


Host = Annotated[str, Field(min_length=1), AfterValidator(_host)]


class Section(BaseModel):
    """A table of the file: unknown keys are mistakes, and so are values of another type."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches an address."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def is_address(device: str) -> bool:
    """Whether a camera is named by its IP address, not by its serial number."""
    try:
        ipaddress.ip_address(device)
    except ValueError:
        return False
    return True
