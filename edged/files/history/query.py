"""Query the history of any number of cells in SQL, with no other read or write access.

DuckDB gets the table `cycles` from pyarrow, which opens the files. DuckDB itself has no access to the file
system, extensions or Python variables, and none of that can be switched on again ("Securing DuckDB" in its
manual: enable_external_access, lock_configuration). Only a single SELECT is run.
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
"""Memory limit of a query; one that needs more fails, as nothing may be spilled to disc."""
PLACE = pa.schema([("plant", pa.string()), ("day", pa.string()), ("cell", pa.string())])
"""Columns given by the path of a file."""
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
    """Data set of all rows of folders and buckets, with `plant`, `day` and `cell`.

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
    """Open a locked connection with the table `cycles`. Raises `UserError`, also for errors of SQL."""
    try:
        cycles = cycles_in(folders)
        with duckdb.connect(":memory:", config=LOCKED) as connection:
            connection.register("cycles", cycles)
            yield connection
    except (duckdb.Error, pa.ArrowException, OSError) as error:
        raise UserError(f"history: {error}") from error


def ask(folders: Sequence[Path | str], sql: str) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Run one SELECT; returns column names and rows. Raises `UserError`."""
    with asked(folders) as connection:
        statements = connection.extract_statements(sql)
        if len(statements) != 1 or statements[0].type != duckdb.StatementType.SELECT:
            raise UserError("history: expected one SELECT")
        answer = connection.execute(statements[0])
        return [column[0] for column in answer.description or ()], answer.fetchall()
