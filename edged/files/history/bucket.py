"""Upload of packed files to an S3 bucket with pyarrow's client; each upload is complete or has no effect.

    s3://BUCKET/PREFIX?region=eu-central-1
    s3://BUCKET/PREFIX?endpoint_override=minio.example:9000&scheme=https

Credentials come from the environment or the files that every AWS client reads (AWS_ACCESS_KEY_ID,
AWS_SHARED_CREDENTIALS_FILE), never from the address.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import pyarrow as pa
from pyarrow import fs

from edged.errors import UserError
from edged.files.atomic import write_atomically

SCHEME = "s3://"
SENT = ".sent"
"""File beside a day's file with the address that it was last sent to, and its size and mtime then."""
CONNECT_S, REQUEST_S, ATTEMPTS = 5.0, 60.0, 3
OPTIONS = {"region", "endpoint_override", "scheme"}
PLACE = re.compile(r"[a-z0-9][a-z0-9.-]{1,61}[a-z0-9](/[A-Za-z0-9_.=-]+)*/?")
"""A bucket's name and an optional prefix."""


def bucket_of(address: str) -> tuple[fs.S3FileSystem, str]:
    """Client for an address, and its BUCKET/PREFIX. Raises `UserError`."""
    place, options = checked(address)
    try:
        retries = fs.AwsStandardS3RetryStrategy(max_attempts=ATTEMPTS)
        client = fs.S3FileSystem(
            connect_timeout=CONNECT_S, request_timeout=REQUEST_S, retry_strategy=retries, **options
        )
    except (pa.ArrowException, OSError, ValueError) as error:
        raise UserError(f"{address}: {error}") from error
    return client, place


def checked(address: str) -> tuple[str, dict[str, Any]]:
    """Split an address into BUCKET/PREFIX and the server's options. Raises `UserError`."""
    found = urlsplit(address)
    place, options = f"{found.netloc}{found.path}", dict(parse_qsl(found.query))
    if not address.startswith(SCHEME) or PLACE.fullmatch(place) is None or not options.keys() <= OPTIONS:
        raise UserError(
            f"{address}: expected s3://BUCKET/PREFIX, perhaps with ?region=, endpoint_override=, scheme="
        )
    return place.rstrip("/"), options


def is_sent(file: Path, address: str) -> bool:
    """Whether the day's file was uploaded to this address in its present state."""
    note = file.with_name(SENT)
    return note.is_file() and note.read_text() == _state(file, address)


def send(files: list[Path], folder: Path, address: str, merge: Callable[[Path, bytes], object]) -> int:
    """Upload files that the bucket lacks; returns how many. Raises `UserError`.

    merge : adds the rows of the bucket's file to ours. Needed for a day that was never sent from here but is
    in the bucket: the disc was replaced, or the day had been removed here.
    """
    todo = [file for file in files if not is_sent(file, address)]
    if not todo:
        return 0
    client, place = bucket_of(address)
    for file in todo:
        path = f"{place}/{file.relative_to(folder)}"
        try:
            is_new = not file.with_name(SENT).exists()
            if is_new and client.get_file_info(path).type == fs.FileType.File:
                with client.open_input_file(path) as there:
                    merge(file, there.read())
            state = _state(file, address)
            with client.open_output_stream(path) as there:
                there.write(file.read_bytes())
        except (pa.ArrowException, OSError) as error:
            raise UserError(f"{address}: {error}") from error
        # written last: if killed before, the same file is sent again
        write_atomically(file.with_name(SENT), state.encode())
    return len(todo)


def files_in(client: fs.S3FileSystem, place: str, name: str) -> list[str]:
    """Paths of the day files in a bucket."""
    wanted = re.compile(rf"{re.escape(place)}/plant=[^/]+/day=[^/]+/cell=[^/]+/{re.escape(name)}")
    found = client.get_file_info(fs.FileSelector(place, recursive=True))
    return sorted(file.path for file in found if wanted.fullmatch(file.path))


def _state(file: Path, address: str) -> str:
    about = file.stat()
    return f"{address} {about.st_size} {about.st_mtime_ns}"
