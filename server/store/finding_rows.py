"""What jobs found, as an index: previewed plans with their expiry, and calibrations."""

import sqlite3
from typing import Any

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
