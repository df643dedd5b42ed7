"""The fencing number: it only grows, also across restarts."""

import sqlite3


def read_fencing(db: sqlite3.Connection) -> int:
    """The highest number that was ever given."""
    return db.execute("SELECT value FROM meta WHERE name = 'fencing'").fetchone()[0]


def save_fencing(db: sqlite3.Connection, fencing: int) -> None:
    """Remember a number; a lower one changes nothing."""
    db.execute("UPDATE meta SET value = max(value, ?) WHERE name = 'fencing'", (fencing,))
