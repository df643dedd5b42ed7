"""The database's schema, one script per version; PRAGMA user_version says how many have run."""

import sqlite3

from server.store.errors import StoreError

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
