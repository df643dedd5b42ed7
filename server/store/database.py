"""One SQLite file, one writer: a thread that runs each piece of work in a transaction, and readers of their own.

A write that fails (disk full, read-only) leaves the database as it was, and `problem` says why until a write succeeds.
"""

import asyncio
import contextlib
import logging
import os
import queue
import sqlite3
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any, TypeVar

from server.errors import ServerError
from server.store.audit_rows import first_fencing, read_floor

# The database's schema, one script per version; PRAGMA user_version says how many have run.

V1 = """
CREATE TABLE meta (name TEXT PRIMARY KEY, value INTEGER NOT NULL) STRICT;
INSERT INTO meta VALUES ('fencing', 0), ('probe', 0);

CREATE TABLE jobs (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    job_id TEXT NOT NULL UNIQUE,
    kind TEXT NOT NULL,
    owner TEXT NOT NULL,
    fencing INTEGER NOT NULL,
    body TEXT NOT NULL,
    state TEXT NOT NULL,
    code TEXT NOT NULL DEFAULT '',
    reason TEXT NOT NULL DEFAULT '',
    started_unix_s REAL NOT NULL,
    elapsed_s REAL NOT NULL DEFAULT 0,
    result TEXT
) STRICT;

CREATE TABLE audit (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    t_unix_s REAL NOT NULL,
    who TEXT NOT NULL,
    role TEXT NOT NULL,
    address TEXT NOT NULL,
    action TEXT NOT NULL,
    outcome TEXT NOT NULL,
    lease_owner TEXT NOT NULL DEFAULT '',
    fencing INTEGER NOT NULL DEFAULT 0,
    request_id TEXT NOT NULL DEFAULT '',
    idempotency_key TEXT NOT NULL DEFAULT '',
    plan_hash TEXT NOT NULL DEFAULT '',
    job_id TEXT NOT NULL DEFAULT '',
    detail TEXT NOT NULL DEFAULT ''
) STRICT;
CREATE TRIGGER audit_stays BEFORE UPDATE ON audit BEGIN SELECT RAISE(ABORT, 'audit is append-only'); END;

CREATE TABLE idempotency (
    who TEXT NOT NULL,
    key TEXT NOT NULL,
    body_hash TEXT NOT NULL,
    status INTEGER NOT NULL,
    location TEXT NOT NULL,
    answer TEXT NOT NULL,
    t_unix_s REAL NOT NULL,
    PRIMARY KEY (who, key)
) STRICT;

CREATE TABLE plans (
    plan_hash TEXT PRIMARY KEY,
    job_id TEXT NOT NULL,
    made_unix_s REAL NOT NULL,
    expires_unix_s REAL NOT NULL,
    view TEXT NOT NULL
) STRICT;

CREATE TABLE calibrations (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    made_unix_s REAL NOT NULL,
    job_id TEXT NOT NULL,
    method TEXT NOT NULL,
    sigma_deg REAL NOT NULL,
    residual_rms_mm REAL NOT NULL,
    view TEXT NOT NULL
) STRICT;
"""
# What lapses goes by the operating-hours counter: rows of before count as written at its beginning, so they are kept.
V2 = """
INSERT INTO meta VALUES ('operating_ms', 0);
ALTER TABLE audit ADD COLUMN operating_s REAL NOT NULL DEFAULT 0;
ALTER TABLE idempotency RENAME COLUMN t_unix_s TO operating_s;
UPDATE idempotency SET operating_s = 0;
"""
MIGRATIONS = (V1, V2)


def migrate(db: sqlite3.Connection, fencing: int) -> None:
    """Bring the schema up to date, each version in a transaction of its own. `fencing`: where a new database begins.

    Raises: StoreError: the file comes from a newer program.
    """
    version = db.execute("PRAGMA user_version").fetchone()[0]
    if version > len(MIGRATIONS):
        raise StoreError(
            f"database has version {version}, this program knows {len(MIGRATIONS)}; start the newer longreach"
        )
    for number, script in enumerate(MIGRATIONS[version:], start=version + 1):
        if number == 1:
            script += f"UPDATE meta SET value = {fencing} WHERE name = 'fencing';"
        db.executescript(f"BEGIN IMMEDIATE;\n{script}\nPRAGMA user_version = {number};\nCOMMIT;")


# Failures of the store. Each one refuses motion: what cannot be written down is not begun.


class StoreError(ServerError):
    """The database cannot be written: read-only, full, damaged, too new, or too slow."""

    code = "store"
    hint = "see GET /readyz: free space, make the folder writable, or move a damaged database away; motion is refused"


class StoreBusyError(StoreError):
    """More is waiting to be written than the queue holds."""

    code = "store_busy"
    hint = "the disk is slower than the requests; try again in a second"


log = logging.getLogger(__name__)
T = TypeVar("T")
Work = Callable[[sqlite3.Connection], T]
WRITE_QUEUE_MAX = 256
WRITE_TIMEOUT_S = 5.0  # longest wait of a command for the disk
SQLITE_BUSY_TIMEOUT_MS = 2000
SQLITE_FILE_SUFFIXES = ("", "-wal", "-shm")  # endings of SQLite's files: as long as it is open they stay
_Item = tuple[Work[Any], Future[Any]] | None


class Database:
    """Opened and closed by its owner; every method may be called from any thread. `path` None: memory, for tests."""

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.problem = "the database is not open"
        self._queue: queue.Queue[_Item] = queue.Queue(WRITE_QUEUE_MAX)
        self._db: sqlite3.Connection | None = None
        self._inodes: list[tuple[int, int] | None] = []  # of the files that `_db` writes to
        self._thread: threading.Thread | None = None

    def open(self) -> None:
        """Start the writer: integrity check and migrations; a failure shows in `problem` and is tried again."""
        self._thread = threading.Thread(target=self._write_all, name="store", daemon=True)
        self._thread.start()
        with contextlib.suppress(StoreError):
            self.write(_probe_write)

    def close(self) -> None:
        """Write what is waiting, then close."""
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join(2 * WRITE_TIMEOUT_S)
            self._thread = None

    # --- writing ----------------------------------------------------------------------------------------------------

    def submit(self, work: Work[T], spare: int = 0) -> Future[T]:
        """Queue one transaction; its result comes with the future. `spare`: places that it leaves to others.

        Raises: StoreBusyError: the queue is full.
        """
        done: Future[T] = Future()
        try:
            if self._queue.qsize() >= WRITE_QUEUE_MAX - spare:
                raise queue.Full
            self._queue.put_nowait((work, done))
        except queue.Full:
            raise StoreBusyError(f"{WRITE_QUEUE_MAX - spare} writes are waiting for the disk") from None
        return done

    def write(self, work: Work[T]) -> T:
        """Run one transaction and wait for it. Raises: StoreError: it was not written."""
        try:
            return self.submit(work).result(WRITE_TIMEOUT_S)
        except TimeoutError:
            raise StoreError(f"the disk did not take a write within {WRITE_TIMEOUT_S:.0f} s") from None

    async def write_async(self, work: Work[T]) -> T:
        """As `write`, for the event loop."""
        try:
            async with asyncio.timeout(WRITE_TIMEOUT_S):
                return await asyncio.wrap_future(self.submit(work))
        except TimeoutError:
            raise StoreError(f"the disk did not take a write within {WRITE_TIMEOUT_S:.0f} s") from None

    def _write_all(self) -> None:
        while (item := self._queue.get()) is not None:
            work, done = item
            if done.set_running_or_notify_cancel():
                self._write_one(work, done)
        if self._db is not None:
            self._db.close()
            self._db = None

    def _write_one(self, work: Work[T], done: Future[T]) -> None:
        try:
            db = self._open_if_needed()
            result = _in_transaction(db, work)
            self._require_in_place()
        except (sqlite3.OperationalError, sqlite3.DatabaseError, OSError, StoreError) as error:
            done.set_exception(self._record_store_error(error))
        except Exception as error:  # the work's own refusal: the transaction is rolled back, the store is well
            done.set_exception(error)
        else:
            if self.problem:
                log.info("store: writing again to %s", self.path)
            self.problem = ""
            done.set_result(result)

    def _record_store_error(self, error: Exception) -> StoreError:
        if isinstance(error, sqlite3.IntegrityError):
            return StoreError(f"database {self.path}: {error}")  # a defect of the work, not of the disk
        text = str(error) if isinstance(error, StoreError) else f"database {self.path}: {error}"
        if text != self.problem:
            log.error("store: %s; motion is refused until it can be written again", text)
        self.problem = text
        return error if isinstance(error, StoreError) else StoreError(text)

    def _open_if_needed(self) -> sqlite3.Connection:
        if self._db is None:
            self._db, self._inodes = _open_connection(self.path), []
        return self._db

    def _require_in_place(self) -> None:
        """Raises: StoreError: what was written now is not where the next life of the server will look for it."""
        if self.path is None:
            return
        inodes = [_device_and_inode(f"{self.path}{ending}") for ending in SQLITE_FILE_SUFFIXES]
        self._inodes = self._inodes or inodes
        if inodes[0] is None or inodes != self._inodes:
            raise StoreError(
                f"database {self.path} was removed or replaced while the server ran, so nothing that it writes now is "
                "kept; end the server, put the database back from a backup if there is one, and start it again"
            )

    # --- reading ----------------------------------------------------------------------------------------------------

    def read(self, work: Work[T]) -> T:
        """Run a query alongside the writer, on what was committed last. Raises: StoreError: the file cannot be read."""
        if self.path is None:
            return self.write(work)
        try:
            with contextlib.closing(sqlite3.connect(f"{self.path.absolute().as_uri()}?mode=ro", uri=True)) as db:
                db.row_factory = sqlite3.Row
                return work(db)
        except sqlite3.Error as error:
            raise StoreError(f"database {self.path}: {error}") from error

    async def read_async(self, work: Work[T]) -> T:
        """As `read`, for the event loop."""
        return await asyncio.to_thread(self.read, work)


def _device_and_inode(name: str) -> tuple[int, int] | None:
    try:
        found = os.stat(name)
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _open_connection(path: Path | None) -> sqlite3.Connection:
    """Open, check and migrate.

    Raises: StoreError: damaged, or from a newer program. sqlite3.Error, OSError: cannot be opened.
    """
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
    db = sqlite3.connect(":memory:" if path is None else path, isolation_level=None, check_same_thread=False)
    try:
        db.row_factory = sqlite3.Row
        db.execute(f"PRAGMA busy_timeout = {SQLITE_BUSY_TIMEOUT_MS}")
        found = db.execute("PRAGMA integrity_check(3)").fetchall()
        if found[0][0] != "ok":
            raise StoreError(f"database {path} is damaged ({found[0][0]}); move it away and start again")
        db.execute("PRAGMA journal_mode = WAL")
        db.execute("PRAGMA synchronous = FULL")  # a fencing number or a key that was answered survives a power cut
        migrate(db, 0 if path is None else first_fencing(time.time()))
        if path is not None:  # a database that is new, or an old one from a backup, begins above what was given
            db.execute("UPDATE meta SET value = max(value, ?) WHERE name = 'fencing'", (read_floor(path.parent),))
    except BaseException as error:
        db.close()
        if isinstance(error, sqlite3.DatabaseError) and not isinstance(error, sqlite3.OperationalError):
            raise StoreError(f"database {path} is damaged ({error}); move it away and start again") from error
        raise
    return db


def _in_transaction(db: sqlite3.Connection, work: Work[T]) -> T:
    db.execute("BEGIN IMMEDIATE")
    try:
        result = work(db)
        db.execute("COMMIT")
    except BaseException:
        if db.in_transaction:  # a full disk rolls back by itself
            db.execute("ROLLBACK")
        raise
    return result


def _probe_write(db: sqlite3.Connection) -> None:
    """A write that changes nothing that matters: says whether writing is possible."""
    db.execute("UPDATE meta SET value = value + 1 WHERE name = 'probe'")


PROBE: Work[None] = _probe_write
