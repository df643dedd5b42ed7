"""The audit: who commanded what, under which lease, and what came of it. Append-only."""

import sqlite3
from dataclasses import asdict, dataclass
from typing import Any

from server.store.operating_time import NOW_S

KEPT_S = 400 * 86400.0  # of operation


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
_INSERT = f"INSERT INTO audit ({_NAMES}, operating_s) VALUES ({', '.join(':' + name for name in _COLUMNS)}, {NOW_S})"


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
    """Lines older than KEPT_S of operation go."""
    db.execute(f"DELETE FROM audit WHERE operating_s < {NOW_S} - ?", (KEPT_S,))
