"""The operating-hours counter: time that passed while a server ran on this database. All that lapses here lapses by it.

The wall clock is set, forwards and backwards, and begins in 1970 on a computer without a battery clock: by it a day's
answers and a year's audit would lapse in a second. Time in which no server runs is not counted: things are kept longer.
"""

import sqlite3

NOW_S = "(SELECT value / 1000.0 FROM meta WHERE name = 'operating_ms')"  # in a statement: the counter as it stands


def read_operating_time(db: sqlite3.Connection) -> float:
    """The counter [s] as it was written last."""
    return db.execute(f"SELECT {NOW_S}").fetchone()[0]


def save_operating_time(db: sqlite3.Connection, operating_s: float) -> None:
    """Set the counter on; a lower value changes nothing."""
    db.execute("UPDATE meta SET value = max(value, ?) WHERE name = 'operating_ms'", (round(operating_s * 1e3),))
