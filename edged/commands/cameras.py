"""`edged cameras`: cameras on the network, and a report on two of them."""

from __future__ import annotations

import asyncio
import json
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Column, Table

from edged.app.camerareport import camera_report
from edged.app.discovery import (
    CameraInfo,
    DiscoveredCamera,
    aravis_missing,
    give_address,
    list_cameras,
    with_addresses,
)
from edged.errors import CaptureError, UserError
from edged.files.atomic import write_file
from edged.files.outputs import check_outputs
from edged.payload import Json


def cameras(as_json: bool, console: Console) -> int:
    """List every GenICam camera that answers; 0 if there is any, else 1."""
    if missing := aravis_missing():
        raise UserError(missing)
    found = with_addresses(list_cameras())
    if as_json:
        print(json.dumps([_fields(info, heard) for info, heard in found]))
    elif found:
        whole = [Column(name, no_wrap=True) for name in ("serial", "address")]  # users copy these
        table = Table(whole[0], "vendor", "model", whole[1], "by", "protocol", "use")
        helps = []
        for info, heard in found:
            by = "" if heard is None else heard.ways
            use = info.control or "not asked"
            if heard is not None and heard.is_lost:
                use = f"not in {heard.host.network} of {heard.port}"
                helps.append(f"edged cameras --give-address {info.serial}")
            table.add_row(info.serial, info.vendor, info.model, info.address, by, info.protocol, use)
        console.print(table)
        for command in helps:
            console.print(f"help: {command}", highlight=False, markup=False, soft_wrap=True)
    else:
        console.print(
            "no camera answers: cable, power, and is a port of this machine in the camera's network?"
        )
    return 0 if found else 1


def address(serial: str, wanted: str, console: Console) -> int:
    """Give a camera an address in this machine's network; "": a free one. Returns 0, or 1 on failure."""
    try:
        given, is_kept = give_address(serial, wanted)
    except CaptureError as error:
        console.print(str(error), highlight=False, markup=False)
        return 1
    kept = "and keeps it" if is_kept else "until it is switched off: it cannot keep one"
    console.print(f"{serial} is at {given}, {kept}", highlight=False, markup=False)
    return 0


def _fields(info: CameraInfo, heard: DiscoveredCamera | None) -> Json:
    """Fields of a camera for `--json`."""
    reached = {"address_by": "", "in_network": True}
    if heard is not None:
        reached = {"address_by": heard.ways, "in_network": not heard.is_lost}
    return {**asdict(info), **reached}


def report(file: Path, devices: list[str], minutes: float, console: Console) -> int:
    """Test two cameras for some minutes and write the report to a file; 0, or 1 if they cannot be used."""
    if missing := aravis_missing():
        raise UserError(missing)
    check_outputs({"--report": file})
    found = list_cameras()
    chosen = devices or [_name(info) for info in found]
    if len(chosen) != 2:
        raise UserError(f"--report needs two cameras, and {len(chosen)} answer: name both with --device")
    console.print(f"looking at {chosen[0]} and {chosen[1]} for {minutes:g} minutes ...")
    try:
        seen = asyncio.run(camera_report(chosen, 60 * minutes))
    except CaptureError as error:
        console.print(f"no report: {error}")
        return 1
    write_file(file, json.dumps(seen, indent=1).encode() + b"\n")
    for line in _lines(seen):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    console.print(f"written to {file}, without serial numbers and addresses", markup=False)
    return 0


def _name(info: CameraInfo) -> str:
    return info.address if info.protocol == "GigEVision" else info.serial


def _lines(seen: Json) -> list[str]:
    together, full = seen["together"], seen["full_rate"]
    lines = []
    for camera, rate, temperature in zip(
        seen["cameras"], full["cameras"], together["temperature_c"], strict=True
    ):
        degrees = "no temperature" if temperature is None else f"{temperature:.1f} °C"
        failed, resent, lost = (rate.get(name, 0) for name in ("failed", "resent", "lost"))
        lines.append(
            f"{camera['vendor']} {camera['model']}, firmware {camera['firmware'] or 'unknown'}: "
            f"{len(camera['features'])} features, {degrees}; at full rate {rate['rate_hz']:g} images/s, "
            f"{failed} damaged, {resent} packets resent, {lost} lost"
        )
        lines += [f"  has not: {lack}" for lack in camera["lacks"]]
    lines.append(f"{together['pairs']} pairs; faults: {together['faults'] or 'none'}")
    if together["pairs"]:
        (skew_us, most_us), (time_ms, slow_ms) = together["skew_us"], together["trigger_to_images_ms"]
        lines.append(f"skew of both exposures: {skew_us:g} us in the middle, {most_us:g} us in 99 of 100")
        lines.append(f"trigger to both images: {time_ms:g} ms in the middle, {slow_ms:g} ms in 99 of 100")
    return lines
