"""The audit: who commanded what, under which lease, and what came of it. Append-only."""

import contextlib
import os
import sqlite3
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from recording.files import write_durably

# The operating-hours counter: time that passed while a server ran on this database. All that lapses here lapses by
# it.

# In a statement: the counter as it stands
OPERATING_TIME_S_SQL = "(SELECT value / 1000.0 FROM meta WHERE name = 'operating_ms')"


def read_operating_time(db: sqlite3.Connection) -> float:
    """The counter [s] as it was written last."""
    return db.execute(f"SELECT {OPERATING_TIME_S_SQL}").fetchone()[0]


def save_operating_time(db: sqlite3.Connection, operating_s: float) -> None:
    """Set the counter on; a lower value changes nothing."""
    db.execute("UPDATE meta SET value = max(value, ?) WHERE name = 'operating_ms'", (round(operating_s * 1e3),))


AUDIT_RETENTION_S = 400 * 86400.0  # of operation


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """One line. `outcome` is "accepted" or the code of the refusal. Secrets never go in."""

    t_unix_s: float
    who: str
    role: str
    address: str
    action: str
    outcome: str = "accepted"
    lease_owner: str = ""
    fencing: int = 0
    request_id: str = ""
    idempotency_key: str = ""
    plan_hash: str = ""
    job_id: str = ""
    detail: str = ""


_COLUMNS = tuple(AuditEntry.__dataclass_fields__)
_NAMES = ", ".join(_COLUMNS)
_VALUES = ", ".join(":" + name for name in _COLUMNS)
_INSERT = f"INSERT INTO audit ({_NAMES}, operating_s) VALUES ({_VALUES}, {OPERATING_TIME_S_SQL})"


def add_audit(db: sqlite3.Connection, entry: AuditEntry) -> None:
    """Append one line."""
    db.execute(_INSERT, asdict(entry))


def read_audit(db: sqlite3.Connection, before: int, limit: int) -> list[dict[str, Any]]:
    """The newest lines with a number below `before`, newest first."""
    rows = db.execute(
        f"SELECT number, {_NAMES} FROM audit WHERE number < ? ORDER BY number DESC LIMIT ?", (before, limit)
    )
    return [dict(row) for row in rows]


def forget_old_audit(db: sqlite3.Connection) -> None:
    """Delete audit lines older than AUDIT_RETENTION_S of operating time."""
    db.execute(f"DELETE FROM audit WHERE operating_s < {OPERATING_TIME_S_SQL} - ?", (AUDIT_RETENTION_S,))


# The fencing number: it only grows, also across restarts.


def read_fencing(db: sqlite3.Connection) -> int:
    """The highest number that was ever given."""
    return db.execute("SELECT value FROM meta WHERE name = 'fencing'").fetchone()[0]


def first_fencing(t_unix_s: float) -> int:
    """Where a new database begins: milliseconds since 1970, above all that a database which was lost can have given.

    It began the same way and gave one number a holder; taking control lasts longer than 1 ms, so time has overtaken it.
    """
    return max(0, round(t_unix_s * 1e3))


def save_fencing(db: sqlite3.Connection, fencing: int) -> None:
    """Remember a number, also outside the database; a lower one changes nothing.

    Raises: OSError: the floor cannot be written.
    """
    if file := db.execute("PRAGMA database_list").fetchone()["file"]:
        keep_floor(Path(file).parent, fencing)
    db.execute("UPDATE meta SET value = max(value, ?) WHERE name = 'fencing'", (fencing,))


FLOOR, FLOOR_ATTRIBUTE = "longreach.fencing", "user.longreach.fencing"


def read_floor(folder: Path) -> int:
    """The highest number that was given in this folder, whatever became of its database; 0 where none is known.

    It is in a file, and in an attribute of the folder, which stays when all files in it are removed.
    """
    found = [0]
    with contextlib.suppress(OSError, ValueError):
        found.append(int((folder / FLOOR).read_bytes()))
    with contextlib.suppress(OSError, ValueError, AttributeError):  # not every system has attributes
        found.append(int(os.getxattr(folder, FLOOR_ATTRIBUTE)))
    return max(found)


def keep_floor(folder: Path, fencing: int) -> None:
    """Have a number on disk before a client gets it. Raises: OSError: it is not."""
    if fencing <= read_floor(folder):
        return
    with contextlib.suppress(OSError, AttributeError):  # the file is there as well
        os.setxattr(folder, FLOOR_ATTRIBUTE, str(fencing).encode())
    write_durably(folder / FLOOR, f"{fencing}\n")  # the folder, too


# What jobs found, as an index: previewed plans with their expiry, and calibrations.

PLANS_KEPT = 1000
CALIBRATIONS_KEPT = 10_000


def add_plan(
    db: sqlite3.Connection, plan_hash: str, job_id: str, made_unix_s: float, expires_unix_s: float, view: str
) -> None:
    """A previewed plan; the same plan previewed again takes its new expiry."""
    values = (plan_hash, job_id, made_unix_s, expires_unix_s, view)
    db.execute("INSERT OR REPLACE INTO plans VALUES (?, ?, ?, ?, ?)", values)
    db.execute(
        "DELETE FROM plans WHERE plan_hash NOT IN (SELECT plan_hash FROM plans ORDER BY rowid DESC LIMIT ?)",
        (PLANS_KEPT,),
    )


def read_plan(db: sqlite3.Connection, plan_hash: str) -> dict[str, Any] | None:
    """The plan of that hash."""
    row = db.execute("SELECT * FROM plans WHERE plan_hash = ?", (plan_hash,)).fetchone()
    return None if row is None else dict(row)


def add_calibration(
    db: sqlite3.Connection, made_unix_s: float, job_id: str, method: str, sigma_deg: float, rms_mm: float, view: str
) -> None:
    """A calibration that a job left behind."""
    db.execute(
        "INSERT INTO calibrations (made_unix_s, job_id, method, sigma_deg, residual_rms_mm, view) "
        "VALUES (?, ?, ?, ?, ?, ?)",
        (made_unix_s, job_id, method, sigma_deg, rms_mm, view),
    )
    db.execute(
        "DELETE FROM calibrations WHERE number <= (SELECT max(number) FROM calibrations) - ?", (CALIBRATIONS_KEPT,)
    )


def read_calibrations(db: sqlite3.Connection, before: int, limit: int) -> list[dict[str, Any]]:
    """The newest calibrations with a number below `before`, newest first."""
    rows = db.execute("SELECT * FROM calibrations WHERE number < ? ORDER BY number DESC LIMIT ?", (before, limit))
    return [dict(row) for row in rows]
