"""The fencing number: it only grows, also across restarts."""

import sqlite3


def read_fencing(db: sqlite3.Connection) -> int:
    """The highest number that was ever given."""
    return db.execute("SELECT value FROM meta WHERE name = 'fencing'").fetchone()[0]


def first_fencing(t_unix_s: float) -> int:
    """Where a new database begins: milliseconds since 1970, above all that a database which was lost can have given.

    It began the same way and gave one number a holder; taking control lasts longer than 1 ms, so time has overtaken it.
    """
    return max(0, round(t_unix_s * 1e3))


def save_fencing(db: sqlite3.Connection, fencing: int) -> None:
    """Remember a number; a lower one changes nothing."""
    db.execute("UPDATE meta SET value = max(value, ?) WHERE name = 'fencing'", (fencing,))
