"""What a foreign file holds once it is read: columns with their names and units as they are written there."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass, field, replace
from pathlib import Path

from needle_rig.config.places import show_path
from needle_rig.errors import BadInput
from needle_rig.importing import names
from needle_rig.numerics import Array

LIMIT_BYTES = 4_000_000_000
"""A hundred million rows of four columns; what is larger does not fit into a laptop's memory as numbers."""
MAX_COLUMNS = 1000
"""As in datasets: far above any rig's sensors, and columns are compared with each other."""
HASH_BYTES = 1 << 22
SHEETS = "spreadsheet"
"""First word of the dialect of a file whose tables are sheets."""


@dataclass(frozen=True)
class Column:
    """One column of a file. Columns of one `table` have a row in common, and therefore a clock."""

    name: str
    """Unique in its file."""
    unit: str
    """As written in the file, empty where it says none."""
    values: Array
    """(rows,), NaN where there is no number; of a column of words, their places in `labels`."""
    table: str = ""
    labels: tuple[str, ...] = ()
    fault: str = ""
    """Why nothing of it can be used, in words; such a column is kept to be named."""


Read = tuple[str, tuple[Column, ...], dict[str, float]]
"""What a reader gives: dialect in words, columns, and samples a second by table, where said."""


@dataclass(frozen=True)
class Recording:
    """One file: its columns, and how it was understood."""

    path: Path
    sha256: str
    dialect: str
    """Format and separators, in words."""
    columns: tuple[Column, ...]
    rates_hz: dict[str, float] = field(default_factory=dict)
    """Samples a second by table, where the file says so."""

    table: str = ""
    """Of several tables that each hold the same columns: the one that this recording is."""

    def repeats(self) -> list[Recording]:
        """One recording a table, where the tables are trials: sheets, or called so, with the same columns."""
        tables = list(dict.fromkeys(c.table for c in self.columns))
        alone = [self.alone(table) for table in tables]
        same = len({tuple((c.name, c.unit) for c in r.columns) for r in alone}) == 1
        called = all(names.TRIAL.fullmatch(re.sub(r"\W*\d+$", "", names.plain(t))) for t in tables)
        trials = len(tables) > 1 and same and (self.dialect.startswith(SHEETS) or called)
        return alone if trials else [self]

    def alone(self, table: str) -> Recording:
        """That table of the recording, its columns called without it; all where none is named."""
        if not table:
            return self
        own = [c for c in self.columns if c.table == table]
        columns = tuple(replace(c, name=c.name.removeprefix(f"{table}/"), table="") for c in own)
        if not own:
            told = ", ".join(dict.fromkeys(c.table for c in self.columns))
            raise BadInput(f"{show_path(self.path)}: has no table {table}; it has {told}")
        rate_hz = self.rates_hz.get(table, self.rates_hz.get(""))
        rates_hz = {} if rate_hz is None else {"": rate_hz}
        return replace(self, columns=columns, rates_hz=rates_hz, table=table)

    def column(self, name: str) -> Column | None:
        """The column of that name, None without one."""
        return next((c for c in self.columns if c.name == name), None)

    def tables(self) -> dict[str, list[Column]]:
        """Columns that can be used by table, in the order of the file."""
        found: dict[str, list[Column]] = {}
        for column in self.columns:
            if column.fault:
                continue
            found.setdefault(column.table, []).append(column)
        return found


def sha256_of(path: Path) -> str:
    """SHA-256 of a file in hexadecimal digits; of a folder, over the names and contents of its files."""
    digest = hashlib.sha256()
    files = sorted(p for p in path.iterdir() if p.is_file()) if path.is_dir() else [path]
    for file in files:
        if path.is_dir():
            digest.update(file.name.encode())
        with file.open("rb") as stream:
            while block := stream.read(HASH_BYTES):
                digest.update(block)
    return digest.hexdigest()
