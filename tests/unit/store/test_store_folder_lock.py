"""One server a recordings folder."""

import os
import shutil
from pathlib import Path

import pytest

from server.errors import SettingsError
from server.store.folder_lock import LOCK_FILE_NAME, alone_in


def test_a_second_server_is_told_who_holds_the_folder(tmp_path: Path) -> None:
    with (
        alone_in(tmp_path / "runs"),
        pytest.raises(SettingsError, match=rf"process {os.getpid()}.*--runs"),
        alone_in(tmp_path / "runs"),
    ):
        pass


def test_it_is_free_again_afterwards_and_after_a_killed_one(tmp_path: Path) -> None:
    (tmp_path / LOCK_FILE_NAME).write_text("4194304\n", encoding="utf-8")  # of a server that was killed
    for _ in range(2):
        with alone_in(tmp_path):
            assert (tmp_path / LOCK_FILE_NAME).read_text(encoding="utf-8") == f"{os.getpid()}\n"


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(SettingsError, match=r"cannot be written: .*--runs"), alone_in(tmp_path / "file"):
        pass


def test_it_is_held_though_all_that_is_in_it_was_removed(tmp_path: Path) -> None:
    with alone_in(tmp_path):
        (tmp_path / LOCK_FILE_NAME).unlink()
        for _ in range(2):
            with pytest.raises(SettingsError, match=r"used by another server.*--runs"), alone_in(tmp_path):
                pass
    with alone_in(tmp_path):
        pass


def test_it_is_held_though_the_folder_itself_was_removed_and_made_anew(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    with alone_in(runs):
        for remade in (False, True):
            shutil.rmtree(runs)
            if remade:
                runs.mkdir()
            with pytest.raises(SettingsError, match=rf"process {os.getpid()}.*--runs"), alone_in(runs):
                pass
        with alone_in(tmp_path / "others"):
            pass
    with alone_in(runs):
        pass
