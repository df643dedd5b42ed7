"""The store: one writer, transactions, migrations, and disks that are full, read-only or damaged."""

import os
import shutil
import sqlite3
import subprocess
import sys
import textwrap
import threading

import pytest

from server.store import database as database_module
from server.store.audit_rows import (
    AuditEntry,
    add_audit,
    add_plan,
    forget_old_audit,
    read_audit,
    read_fencing,
    read_operating_time,
    read_plan,
    save_fencing,
    save_operating_time,
)
from server.store.database import MIGRATIONS, PROBE, Database, StoreBusyError, StoreError

ENTRY = AuditEntry(1000.0, "truck 7", "fleet", "10.0.0.7", "job.park", fencing=3, job_id="a1")


@pytest.fixture
def store(tmp_path, monkeypatch):
    monkeypatch.setattr(database_module, "first_fencing", lambda _t_unix_s: 0)  # numbers that are read easily
    opened = Database(tmp_path / "runs" / "longreach.sqlite3")
    opened.open()
    yield opened
    opened.close()


def test_what_was_written_is_there_in_the_next_life(store):
    store.write(lambda db: save_fencing(db, 7))
    store.close()
    again = Database(store.path)
    again.open()
    assert again.read(read_fencing) == 7
    again.write(lambda db: save_fencing(db, 5))
    assert again.read(read_fencing) == 7  # it only grows
    again.close()


def test_a_transaction_is_whole_or_nothing(store):
    def half(db):
        save_fencing(db, 9)
        raise ValueError("in the middle")

    with pytest.raises(ValueError, match="in the middle"):
        store.write(half)
    assert store.read(read_fencing) == 0
    assert store.problem == ""


def test_the_audit_only_grows_and_old_lines_go(store):
    store.write(lambda db: add_audit(db, ENTRY))
    (line,) = store.read(lambda db: read_audit(db, 2**62, 10))
    assert (line["who"], line["job_id"], line["number"]) == ("truck 7", "a1", 1)
    with pytest.raises(StoreError, match="append-only"):
        store.write(lambda db: db.execute("UPDATE audit SET who = 'somebody else'"))
    store.write(lambda db: save_operating_time(db, 400 * 86400.0))
    store.write(forget_old_audit)
    assert len(store.read(lambda db: read_audit(db, 2**62, 10))) == 1
    store.write(lambda db: save_operating_time(db, 401 * 86400.0))
    store.write(forget_old_audit)
    store.write(lambda db: add_audit(db, ENTRY))
    assert [line["number"] for line in store.read(lambda db: read_audit(db, 2**62, 10))] == [2]  # never used again


def test_a_full_disk_refuses_and_corrupts_nothing_and_is_over_when_there_is_room(store):
    store.write(lambda db: save_fencing(db, 3))
    store.write(lambda db: db.execute("CREATE TABLE big (x BLOB)"))
    pages = store.write(lambda db: db.execute("PRAGMA page_count").fetchone()[0])
    store.write(lambda db: db.execute(f"PRAGMA max_page_count = {pages}"))

    def both(db):
        save_fencing(db, 4)
        db.execute("INSERT INTO big VALUES (zeroblob(1000000))")

    with pytest.raises(StoreError, match="full"):
        store.write(both)
    assert "full" in store.problem
    assert store.read(read_fencing) == 3
    store.write(PROBE)
    assert store.problem == ""
    assert store.read(lambda db: db.execute("PRAGMA integrity_check").fetchone()[0]) == "ok"


FULL = """
import resource, sys
from pathlib import Path
from server.store.audit_rows import AuditEntry, add_audit
from server.store.database import Database
from server.store.database import StoreError
import signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
store = Database(Path(sys.argv[1])); store.open()
assert store.problem == "", store.problem
resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, 150_000))
entry = AuditEntry(1.0, "x", "fleet", "", "y", detail="z" * 5000)
written = 0
try:
    while True:
        store.write(lambda db: add_audit(db, entry)); written += 1
except StoreError as error:
    print(written, bool(store.problem), type(error).__name__)
"""


def test_a_file_that_the_system_lets_grow_no_more_refuses_and_is_sound_afterwards(tmp_path):
    path = tmp_path / "longreach.sqlite3"
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(FULL), str(path)], capture_output=True, text=True)
    written, problem, error = done.stdout.split()
    assert (problem, error) == ("True", "StoreError"), done.stderr
    again = Database(path)
    again.open()
    assert again.problem == ""
    assert len(again.read(lambda db: read_audit(db, 2**62, 1000))) == int(written) > 0
    again.close()


def test_a_folder_that_cannot_be_made_is_a_reason_and_heals(tmp_path):
    (tmp_path / "runs").write_text("a file in the way")
    store = Database(tmp_path / "runs" / "longreach.sqlite3")
    store.open()
    assert "runs" in store.problem
    (tmp_path / "runs").unlink()
    store.write(PROBE)
    assert store.problem == ""
    store.close()


def test_a_read_only_database_is_a_reason(store):
    store.write(lambda db: db.execute("PRAGMA query_only = 1"))
    with pytest.raises(StoreError, match="readonly"):
        store.write(lambda db: save_fencing(db, 1))
    assert "readonly" in store.problem


@pytest.mark.parametrize("what", ["no database", "torn page"])
def test_a_damaged_file_is_named_and_left_as_it_is(store, what):
    for number in range(200):
        store.write(lambda db, n=number: add_audit(db, AuditEntry(float(n), "x", "fleet", "", "y", detail="z" * 500)))
    store.close()
    content = bytearray(store.path.read_bytes())
    if what == "no database":
        content[:16] = b"not a database!!"
    else:
        content[4096 * 3 : 4096 * 8] = bytes(4096 * 5)
    store.path.write_bytes(content)
    again = Database(store.path)
    again.open()
    assert "is damaged" in again.problem
    with pytest.raises(StoreError, match="is damaged"):
        again.write(PROBE)
    again.close()
    assert store.path.read_bytes() == bytes(content)


def test_a_database_of_a_newer_program_is_refused(store):
    store.write(lambda db: db.execute(f"PRAGMA user_version = {len(MIGRATIONS) + 1}"))
    store.close()
    again = Database(store.path)
    again.open()
    assert "start the newer longreach" in again.problem
    again.close()


def test_a_full_queue_refuses_at_once(store):
    hold = threading.Event()
    first = store.submit(lambda db: hold.wait(10.0))
    try:
        with pytest.raises(StoreBusyError):
            list(map(store.submit, [PROBE] * (database_module.WRITE_QUEUE_MAX + 2)))
    finally:
        hold.set()
    assert first.result(5.0)
    store.write(PROBE)


async def test_a_disk_that_hangs_is_given_up(store, monkeypatch):
    monkeypatch.setattr(database_module, "WRITE_TIMEOUT_S", 0.1)
    hold = threading.Event()
    store.submit(lambda db: hold.wait(10.0))
    try:
        with pytest.raises(StoreError, match="did not take a write"):
            await store.write_async(PROBE)
    finally:
        hold.set()


def test_readers_see_what_was_committed_while_a_write_is_under_way(store):
    store.write(lambda db: save_fencing(db, 1))
    inside, hold = threading.Event(), threading.Event()

    def slow(db):
        save_fencing(db, 2)
        inside.set()
        hold.wait(10.0)

    writing = store.submit(slow)
    assert inside.wait(5.0)
    assert store.read(read_fencing) == 1
    hold.set()
    writing.result(5.0)
    assert store.read(read_fencing) == 2


def test_every_version_can_be_brought_up_to_date(tmp_path):
    for version in range(len(MIGRATIONS) + 1):
        path = tmp_path / f"v{version}.sqlite3"
        with sqlite3.connect(path) as db:
            for script in MIGRATIONS[:version]:
                db.executescript(script)
            db.execute(f"PRAGMA user_version = {version}")
        db.close()
        store = Database(path)
        store.open()
        assert store.problem == ""
        assert store.read(lambda db: db.execute("PRAGMA user_version").fetchone()[0]) == len(MIGRATIONS)
        store.close()


@pytest.mark.parametrize("gone", ["everything", "the folder", "the write-ahead log", "replaced by a copy"])
def test_files_that_are_removed_or_replaced_under_it_are_a_reason(store, gone):
    store.write(lambda db: save_fencing(db, 5))
    folder, copy = store.path.parent, store.path.parent.with_name("copy")
    match gone:
        case "everything":
            for file in folder.iterdir():
                file.unlink()
        case "the folder":
            shutil.rmtree(folder)
        case "the write-ahead log":
            store.path.with_name(f"{store.path.name}-wal").unlink()
        case "replaced by a copy":
            shutil.copytree(folder, copy)
            shutil.rmtree(folder)
            copy.rename(folder)
    for _ in range(2):
        with pytest.raises(StoreError, match=r"removed or replaced.*start it again"):
            store.write(PROBE)
        assert "removed or replaced" in store.problem


def test_a_folder_that_was_put_back_is_well_again(store):
    store.write(lambda db: save_fencing(db, 5))
    away = store.path.parent.rename(store.path.parent.with_name("away"))
    with pytest.raises(StoreError, match="removed or replaced"):
        store.write(PROBE)
    away.rename(store.path.parent)
    store.write(PROBE)
    assert store.problem == ""
    assert store.read(read_fencing) == 5


def test_a_database_that_was_lost_gives_no_fencing_number_again(tmp_path, monkeypatch):
    """Not even when many holders came in a short life: each takes longer than 1 ms."""
    highest = 0
    for life in range(3):
        monkeypatch.setattr("server.store.database.time.time", lambda now_s=1.8e9 + 0.1 * life: now_s)
        lost = Database(tmp_path / "runs" / "longreach.sqlite3")
        lost.open()
        before = lost.read(read_fencing)
        assert before > highest
        for number in range(1, 30):
            lost.write(lambda db, n=before + number: save_fencing(db, n))
        highest = lost.read(read_fencing)
        lost.close()
        shutil.rmtree(tmp_path / "runs")


def test_the_counter_of_operating_time_never_falls(store):
    for operating_s in (10.0, 7200.5, 3600.0):
        store.write(lambda db, now_s=operating_s: save_operating_time(db, now_s))
    assert store.read(read_operating_time) == 7200.5


def test_plans_are_kept_in_the_order_of_their_writing_whatever_their_clock_said(store, monkeypatch):
    monkeypatch.setattr("server.store.audit_rows.PLANS_KEPT", 2)
    for plan_hash, made_unix_s in (("a", 2e9), ("b", 1.8e9), ("c", 5.0)):
        store.write(lambda db, h=plan_hash, t=made_unix_s: add_plan(db, h, "job", t, t + 60.0, "{}"))
    kept = [plan_hash for plan_hash in "abc" if store.read(lambda db, h=plan_hash: read_plan(db, h)) is not None]
    assert kept == ["b", "c"]


@pytest.mark.parametrize("lost", ["the database", "everything in the folder", "an old copy"])
def test_fencing_never_falls_though_the_database_is_lost_and_the_clock_is_behind(tmp_path, monkeypatch, lost):
    monkeypatch.setattr("server.store.database.time.time", lambda: 1.8e9)
    store = Database(tmp_path / "runs" / "longreach.sqlite3")
    store.open()
    if lost == "an old copy":
        shutil.copy(store.path, tmp_path / "copy")
    given = store.read(read_fencing) + 5
    store.write(lambda db: save_fencing(db, given))
    store.close()
    keeps_attributes = True
    try:
        os.getxattr(store.path.parent, "user.longreach.fencing")
    except (OSError, AttributeError):
        keeps_attributes = False
    match lost:
        case "the database":
            store.path.unlink()
        case "everything in the folder":
            if not keeps_attributes:
                pytest.skip("this file system keeps no attributes")
            for file in store.path.parent.iterdir():
                file.unlink()
        case "an old copy":
            shutil.copy(tmp_path / "copy", store.path)
    monkeypatch.setattr("server.store.database.time.time", lambda: 5.0)
    again = Database(store.path)
    again.open()
    assert again.read(read_fencing) == given
    again.close()
