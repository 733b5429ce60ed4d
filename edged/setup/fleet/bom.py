"""Makes the bill of materials of a folder of wheels in CycloneDX 1.6, with the official library."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Mapping
from email.message import Message
from email.parser import HeaderParser
from pathlib import Path

from cyclonedx.contrib.license.factories import LicenseFactory
from cyclonedx.model import HashAlgorithm, HashType
from cyclonedx.model.bom import Bom, BomMetaData
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.output.json import JsonV1Dot6
from packageurl import PackageURL

from edged.errors import FileFormatError, UserError
from edged.files.atomic import read_bytes
from edged.setup.fleet.wheelset import OWN, wheels_in

MAX_WHEEL_BYTES = 512 * 1024 * 1024


def bill_of(folder: Path) -> tuple[bytes, Mapping[str, bytes]]:
    """The bill of materials, and the wheels by their SHA-256 and name. Raises `UserError`."""
    files = sorted(folder.glob("*.whl")) if folder.is_dir() else []
    contents = {file: read_bytes(file, "a wheel", MAX_WHEEL_BYTES) for file in files}
    digests = {file: hashlib.sha256(data).hexdigest() for file, data in contents.items()}
    components = [_component(file, digests[file]) for file in files]
    own = next((component for component in components if component.name == OWN), None)
    if own is None:
        raise UserError(f"{folder}: {OWN}-VERSION-py3-none-any.whl is missing: pip wheel --no-deps makes it")
    about = Component(name=OWN, version=own.version, type=ComponentType.APPLICATION, bom_ref="release")
    bom = Bom(components=components, metadata=BomMetaData(component=about))
    bom.register_dependency(about, components)
    data = JsonV1Dot6(bom).output_as_string(indent=1).encode()
    wheels_in(data, str(folder))  # checks that cells can read it
    return data, {f"{digests[file]}.{file.name}": data for file, data in contents.items()}


def _component(file: Path, digest: str) -> Component:
    about = _metadata(file)
    name, version = str(about["Name"]), str(about["Version"])
    licence = about["License-Expression"] or about["License"]
    purl_name = name.lower().replace("_", "-")
    return Component(
        name=name,
        version=version,
        type=ComponentType.LIBRARY,
        bom_ref=file.name,
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=digest)],
        licenses=[LicenseFactory().make_from_string(licence)] if licence and len(licence) < 200 else (),
        purl=PackageURL("pypi", None, purl_name, version, {"file_name": file.name}),
    )


def _metadata(file: Path) -> Message:
    try:
        with zipfile.ZipFile(file) as archive:
            name = next(name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
            about = HeaderParser().parsestr(archive.read(name).decode())
    except (zipfile.BadZipFile, StopIteration, UnicodeDecodeError, OSError) as error:
        raise FileFormatError(f"{file}: not a wheel: {error}") from error
    if not (about["Name"] and about["Version"]):
        raise FileFormatError(f"{file}: not a wheel: neither name nor version")
    return about
