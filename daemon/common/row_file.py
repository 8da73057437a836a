"""Rows of JSON by name in a file of SQLite: what a killed command had finished is there, whole."""

import json
import sqlite3
from pathlib import Path
from typing import Any

Row = dict[str, Any]  # values by column, each a number, a text, a truth value or None


class RowFile:
    """Rows by name, each with what it depends on; without a path they are kept in memory.

    `alone`: nobody else opens it meanwhile. An sqlite3.Error where the file is something else, is
    in use, or cannot be opened.
    """

    def __init__(self, path: Path | None, *, alone: bool = False) -> None:
        self._file = sqlite3.connect(
            path or ":memory:", timeout=0.0 if alone else 2.0, isolation_level=None
        )
        try:
            if alone:
                self._file.executescript("PRAGMA locking_mode=EXCLUSIVE; BEGIN IMMEDIATE; COMMIT;")
            self._file.execute("PRAGMA synchronous=OFF")
            columns = "name TEXT PRIMARY KEY, basis TEXT, row TEXT"
            self._file.execute(f"CREATE TABLE IF NOT EXISTS rows ({columns})")
        except sqlite3.Error:
            self._file.close()
            raise

    def read(self, name: str, basis: str) -> Row | None:
        """The row of a name; None where there is none, or where it depends on something else."""
        found = self._file.execute("SELECT basis, row FROM rows WHERE name=?", (name,)).fetchone()
        return json.loads(found[1]) if found and found[0] == basis else None

    def read_all(self) -> dict[str, tuple[str, Row]]:
        """What each row depends on, and the row, by name."""
        found = self._file.execute("SELECT * FROM rows")
        return {name: (basis, json.loads(row)) for name, basis, row in found}

    def write(self, name: str, basis: str, row: Row) -> None:
        """Keep a row in place of the one of that name; an sqlite3.Error where the disk is full.

        A process that is killed later does not lose it.
        """
        values = (name, basis, json.dumps(row))
        self._file.execute("INSERT OR REPLACE INTO rows VALUES (?,?,?)", values)

    def close(self) -> None:
        """Let others open the file."""
        self._file.close()
