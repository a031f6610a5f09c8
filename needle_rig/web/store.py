"""What the page keeps beside the runs, in one SQLite file: jobs with results, uploads, an index of the runs.

Files that jobs write lie in folders beside it. Nothing here runs as code but what this user's own key seals.
"""

from __future__ import annotations

import fcntl
import hashlib
import hmac
import json
import os
import secrets
import sqlite3
import threading
import zlib
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

from needle_rig.errors import BadInput
from needle_rig.folders import cache_folder

FOLDER = ".page"
"""Beside the runs, as the watch's."""
DATABASE = "page.sqlite"
FORMAT = 1
SEAL = "seal"
RIG_MODEL = "rig_model"
"""Setting: key and name of the model that orders plan with where they name none."""
KEY_BYTES = 32

Document = dict[str, Any]

TABLES = """
CREATE TABLE IF NOT EXISTS jobs (key TEXT PRIMARY KEY, data_hash TEXT, model_hash TEXT, asked_utc_s REAL,
    kept TEXT NOT NULL, result BLOB);
CREATE TABLE IF NOT EXISTS uploads (key TEXT PRIMARY KEY, kept TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS settings (name TEXT PRIMARY KEY, kept TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS runs (name TEXT PRIMARY KEY, stamp TEXT NOT NULL, kept TEXT NOT NULL);
"""


class Store:
    """One file of documents below `folder`, of one server at a time."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._alone = threading.Lock()
        self._database = sqlite3.connect(
            folder / DATABASE, isolation_level=None, check_same_thread=False, timeout=1.0
        )
        self._database.execute("PRAGMA journal_mode=WAL")
        self._database.execute("PRAGMA synchronous=NORMAL")
        known = self._database.execute("PRAGMA user_version").fetchone()[0]
        if known not in (0, FORMAT):
            raise BadInput(f"{folder / DATABASE}: is of another version of needle-rig; move {folder} away")
        self._database.executescript(f"{TABLES} PRAGMA user_version = {FORMAT};")

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    # jobs

    def keep_job(
        self, key: str, hashes: tuple[str, str], asked_utc_s: float, kept: Document, result: Document | None
    ) -> None:
        """Write one job, with its result once it has one. Raises BadInput for a full disk."""
        packed = None if result is None else zlib.compress(json.dumps(result).encode(), 1)
        self._write(
            "INSERT OR REPLACE INTO jobs VALUES (?, ?, ?, ?, ?, ?)",
            (key, *hashes, asked_utc_s, json.dumps(kept), packed),
        )

    def touch_job(self, key: str, asked_utc_s: float) -> None:
        """A result that was requested again is the newest of its kind."""
        with suppress(BadInput):  # it is shown all the same
            self._write("UPDATE jobs SET asked_utc_s = ? WHERE key = ?", (asked_utc_s, key))

    def jobs(self) -> Iterator[tuple[str, tuple[str, str], float, Document]]:
        """All jobs without their results, oldest first: key, hashes, when it was asked, what is kept."""
        wanted = "key, data_hash, model_hash, asked_utc_s, kept"
        rows = self._database.execute(f"SELECT {wanted} FROM jobs ORDER BY asked_utc_s")
        for key, data_hash, model_hash, asked_utc_s, kept in rows.fetchall():
            yield key, (data_hash, model_hash), asked_utc_s, json.loads(kept)

    def result(self, key: str) -> bytes:
        """What a job found, as JSON; null where it found nothing."""
        row = self._database.execute("SELECT result FROM jobs WHERE key = ?", (key,)).fetchone()
        return b"null" if row is None or row[0] is None else zlib.decompress(row[0])

    def forget_job(self, key: str) -> None:
        """Remove its row."""
        with suppress(BadInput):
            self._write("DELETE FROM jobs WHERE key = ?", (key,))

    # uploads

    def keep_upload(self, key: str, kept: Document | None) -> None:
        """Write one upload; None forgets it. Raises BadInput for a full disk."""
        if kept is None:
            self._write("DELETE FROM uploads WHERE key = ?", (key,))
        else:
            self._write("INSERT OR REPLACE INTO uploads VALUES (?, ?)", (key, json.dumps(kept)))

    def uploads(self) -> dict[str, Document]:
        """All uploads by key, oldest first."""
        rows = self._database.execute("SELECT key, kept FROM uploads ORDER BY rowid")
        return {key: json.loads(kept) for key, kept in rows.fetchall()}

    # what a person set

    def keep_setting(self, name: str, kept: Document | None) -> None:
        """Write one setting; None forgets it. Raises BadInput for a full disk."""
        if kept is None:
            self._write("DELETE FROM settings WHERE name = ?", (name,))
        else:
            self._write("INSERT OR REPLACE INTO settings VALUES (?, ?)", (name, json.dumps(kept)))

    def setting(self, name: str) -> Document | None:
        """One setting; None where nobody set it."""
        return _setting(self._database, name)

    # the index of runs

    def runs(self) -> dict[str, tuple[str, Document]]:
        """What is known of each run, and the stamp of the file that it was read from."""
        rows = self._database.execute("SELECT name, stamp, kept FROM runs")
        return {name: (stamp, json.loads(kept)) for name, stamp, kept in rows.fetchall()}

    def keep_runs(self, read: dict[str, tuple[str, Document]], gone: list[str]) -> None:
        """Take what was read anew into the index, and what is gone out of it."""
        with suppress(BadInput):  # they are read again next time
            self._write_many("DELETE FROM runs WHERE name = ?", [(name,) for name in gone])
            self._write_many(
                "INSERT OR REPLACE INTO runs VALUES (?, ?, ?)",
                [(name, stamp, json.dumps(kept)) for name, (stamp, kept) in read.items()],
            )

    def _write(self, statement: str, values: tuple[Any, ...]) -> None:
        self._write_many(statement, [values])

    def _write_many(self, statement: str, rows: list[tuple[Any, ...]]) -> None:
        if not rows:
            return
        try:
            with self._alone:
                self._database.execute("BEGIN")
                try:
                    self._database.executemany(statement, rows)
                    self._database.execute("COMMIT")
                except sqlite3.Error:
                    with suppress(sqlite3.Error):
                        self._database.execute("ROLLBACK")
                    raise
        except sqlite3.Error as error:
            raise BadInput(f"{self.folder}: cannot be written ({error}); make room on this disk") from None


@contextmanager
def opened(runs: Path, otherwise: Path) -> Iterator[tuple[Store, str]]:
    """The store beside `runs`, or one in `otherwise` with the sentence why its work ends with this server."""
    why = ""
    folder, lock = runs / FOLDER, -1
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        store = Store(folder)
    except BlockingIOError:
        why = f"another needle-rig web keeps its work in {folder}; the work of this one ends with it"
    except (OSError, sqlite3.Error, BadInput) as error:
        why = f"{folder}: cannot be used ({error}); the work of this page ends with it"
    if why:
        otherwise.mkdir(parents=True, exist_ok=True)
        store = Store(otherwise)
    try:
        with closing(store):
            yield store, why
    finally:
        if lock >= 0:
            os.close(lock)


def _setting(database: sqlite3.Connection, name: str) -> Document | None:
    row = database.execute("SELECT kept FROM settings WHERE name = ?", (name,)).fetchone()
    kept: Document | None = None if row is None else json.loads(row[0])
    return kept


def rig_model_name(runs: Path) -> str:
    """The model that a person set as the rig's on the page beside `runs`; empty where none is known."""
    path = (runs / FOLDER / DATABASE).absolute()
    with (
        suppress(sqlite3.Error, ValueError),
        closing(sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True)) as found,
    ):
        return str((_setting(found, RIG_MODEL) or {}).get("name", ""))
    return ""


def seal(folder: Path) -> None:
    """Remember that this user's own server wrote the Python files in `folder`."""
    (folder / SEAL).write_text(_signature(folder), encoding="ascii")


def sealed(folder: Path) -> bool:
    """Whether the Python files in `folder` are those that this user's own server wrote there."""
    try:
        said = (folder / SEAL).read_text(encoding="ascii")
        return hmac.compare_digest(said, _signature(folder))
    except (OSError, ValueError):
        return False


def _signature(folder: Path) -> str:
    signed = hmac.new(_own_key(), digestmod=hashlib.sha256)
    for path in sorted(folder.glob("*.py")):
        signed.update(
            hashlib.sha256(path.name.encode()).digest() + hashlib.sha256(path.read_bytes()).digest()
        )
    return signed.hexdigest()


def _own_key() -> bytes:
    """A secret of this user, which no folder of runs carries along."""
    path = cache_folder() / "page.key"
    path.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileExistsError):
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(secrets.token_bytes(KEY_BYTES))
    key = path.read_bytes()
    if len(key) != KEY_BYTES:
        raise ValueError("the key is damaged")
    return key
