"""API keys: the command, the file, revocation while a server runs."""

import pytest
from typer.testing import CliRunner

from longreach.cli import app
from server.access.keys import KeyRing, KeysError, first_key, key_by_secret, read_keys, write_keys
from server.access.roles import Role


def keys(*words):
    return CliRunner().invoke(app, ["keys", *map(str, words)])


def secret_of(result):
    return next(line for line in result.output.splitlines() if line.startswith("longreach_"))


def test_a_key_is_made_listed_used_and_revoked(tmp_path):
    file = tmp_path / "keys.json"
    secret = secret_of(keys("add", "truck 7", "--role", "fleet", "--file", file))
    ring = KeyRing(file)
    assert (ring.find_key(secret, 0.0).name, ring.find_key(secret, 0.0).role) == ("truck 7", Role.FLEET)
    assert ring.find_key(secret + "x", 0.0) is None
    listed = keys("list", "--file", file).output
    assert "truck 7" in listed
    assert secret not in listed
    assert keys("revoke", "truck 7", "--file", file).exit_code == 0
    assert ring.find_key(secret, 1e9) is None
    assert ring.has_no_valid_key
    assert isinstance(keys("revoke", "truck 7", "--file", file).exception, KeysError)
    assert secret_of(keys("add", "truck 7", "--role", "fleet", "--file", file)) != secret


def test_a_name_in_force_is_not_given_twice_and_a_role_is_one_of_five(tmp_path):
    file = tmp_path / "keys.json"
    keys("add", "anna", "--file", file)
    assert isinstance(keys("add", "anna", "--file", file).exception, KeysError)
    assert keys("add", "bert", "--role", "king", "--file", file).exit_code == 2
    assert len(read_keys(file)) == 1


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"keys": [{"name": 1}]}', '{"keys": [{"role": "king"}]}'])
def test_a_file_that_is_none_is_named(tmp_path, text):
    file = tmp_path / "keys.json"
    file.write_text(text)
    with pytest.raises(KeysError, match=r"keys\.json"):
        read_keys(file)


def test_the_first_key_is_made_once_and_read_by_its_owner_only(tmp_path):
    file, secret = tmp_path / "keys" / "keys.json", tmp_path / "keys" / "first.txt"
    assert first_key(file, Role.OPERATOR, secret)
    assert not first_key(file, Role.OPERATOR, secret)
    assert secret.stat().st_mode & 0o077 == 0
    assert key_by_secret(read_keys(file), secret.read_text().strip()).name == "first"


def test_a_ring_that_cannot_read_its_file_holds_no_key_until_it_can(tmp_path):
    file = tmp_path / "keys.json"
    secret = secret_of(keys("add", "anna", "--file", file))
    ring, whole = KeyRing(file), file.read_text()
    file.write_text(whole[:40])
    for now_s in (1e9, 1e9 + 0.1, 1e9 + 10.0):
        assert ring.find_key(secret, now_s) is None
        assert "keys.json" in ring.why_no_key_valid
    file.write_text(whole)
    assert ring.find_key(secret, 1e9 + 20.0).name == "anna"
    assert ring.why_no_key_valid == ""
    file.unlink()
    assert ring.find_key(secret, 1e9 + 30.0) is None
    assert "not there" in ring.why_no_key_valid


def test_a_server_does_not_start_with_a_key_file_that_cannot_be_read(tmp_path):
    (tmp_path / "keys.json").write_text("{")
    with pytest.raises(KeysError):
        KeyRing(tmp_path / "keys.json")


def test_a_file_that_is_written_again_keeps_owner_and_mode(tmp_path, monkeypatch):
    file = tmp_path / "keys.json"
    keys("add", "anna", "--file", file)
    assert file.stat().st_mode & 0o777 == 0o600
    file.chmod(0o640)
    given = []
    monkeypatch.setattr("os.chown", lambda path, uid, gid: given.append((path.name, uid, gid)))
    assert keys("revoke", "anna", "--file", file).exit_code == 0
    assert file.stat().st_mode & 0o777 == 0o640
    assert given == [("keys.json.part", file.stat().st_uid, file.stat().st_gid)]


def test_where_the_owner_cannot_be_kept_the_mode_is_not_widened_for_another_group(tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    file = tmp_path / "keys.json"
    keys("add", "anna", "--file", file)
    file.chmod(0o640)
    monkeypatch.setattr("os.chown", refuse)
    write_keys(file, ())
    assert file.stat().st_mode & 0o777 == 0o600
