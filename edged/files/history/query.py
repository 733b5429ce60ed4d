"""Questions to the history of any number of cells, in SQL, which can neither write nor read anything else.

DuckDB gets the table `cycles` from pyarrow, which opens the files, and may itself open none: no file system,
no extension, no variable of the process, and none of that can be switched on again ("Securing DuckDB" in its
manual: enable_external_access, lock_configuration). One statement that only reads is run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa
from pyarrow import dataset

from edged.errors import FileFormatError, UserError
from edged.files.history.bucket import bucket_of, files_in
from edged.files.history.packing import FILE, SCHEMA

MEMORY = "1GB"
"""For a question; one that needs more is refused, as nothing may be written aside."""
PLACE = pa.schema([("plant", pa.string()), ("day", pa.string()), ("cell", pa.string())])
"""What the path of a file says."""
LOCKED: dict[str, str | bool | int | float | list[str]] = {
    "enable_external_access": "false",
    "autoinstall_known_extensions": "false",
    "autoload_known_extensions": "false",
    "python_enable_replacements": "false",
    "memory_limit": MEMORY,
    "temp_directory": "",
    "lock_configuration": "true",
}


def cycles_in(folders: Sequence[Path | str]) -> dataset.Dataset:
    """All rows of folders and buckets, with `plant`, `day` and `cell`.

    Raises `UserError` where there are none.
    """
    found = []
    for folder in folders:
        if isinstance(folder, str):
            client, base = bucket_of(folder)
            files = files_in(client, base, FILE)
        else:
            client, base = None, str(folder)
            files = sorted(map(str, folder.glob(f"plant=*/day=*/cell=*/{FILE}")))
        if not files:
            raise FileFormatError(
                f"{folder}: no history: expected plant=.../day=.../cell=.../{FILE}; cells pack it every hour"
            )
        places = dataset.partitioning(PLACE, flavor="hive")
        schema = pa.unify_schemas([SCHEMA, PLACE])
        found.append(
            dataset.dataset(files, schema, "parquet", client, partitioning=places, partition_base_dir=base)
        )
    return found[0] if len(found) == 1 else dataset.dataset(found)


@contextmanager
def asked(folders: Sequence[Path | str]) -> Iterator[duckdb.DuckDBPyConnection]:
    """A locked connection with the table `cycles`. Raises `UserError`, also for what SQL raises."""
    try:
        cycles = cycles_in(folders)
        with duckdb.connect(":memory:", config=LOCKED) as connection:
            connection.register("cycles", cycles)
            yield connection
    except (duckdb.Error, pa.ArrowException, OSError) as error:
        raise UserError(f"history: {error}") from error


def ask(folders: Sequence[Path | str], sql: str) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Names of columns and rows of the answer. Raises `UserError`."""
    with asked(folders) as connection:
        statements = connection.extract_statements(sql)
        if len(statements) != 1 or statements[0].type != duckdb.StatementType.SELECT:
            raise UserError("history: expected one SELECT")
        answer = connection.execute(statements[0])
        return [column[0] for column in answer.description or ()], answer.fetchall()
