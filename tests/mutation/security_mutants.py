"""A pytest plugin that takes one defence of the REST side away, named by LONGREACH_MUTANT, before any test runs."""

import logging
import os

from server.access import gatekeeper, keys
from server.access.desk import LeaseDesk
from server.access.gatekeeper import Gatekeeper, Lockout
from server.access.keys import read_keys
from server.access.roles import Caller, Role
from server.access.sessions import Sessions
from server.api import diagnoses, guard, job_commands, lease, runs
from server.api.lease import ControlLog

ANYBODY = Caller("mallory", "admin", "10.0.0.9")


async def endless_body(receive):
    parts, more = [], True
    while more:
        message = await receive()
        parts.append(message.get("body", b""))
        more = message.get("more_body", False)
    return guard._BufferedBody(b"".join(parts), receive)


def log_headers():
    whole = guard.Guard.__call__

    async def told(self, scope, receive, send):
        logging.getLogger("mutant").warning("%s", scope.get("headers"))
        return await whole(self, scope, receive, send)

    guard.Guard.__call__ = told


def joined(folder, relative):
    return folder / f"{relative}.mcap" if (folder / f"{relative}.mcap").exists() else None


def put(owner, name, value):
    getattr(owner, name)  # one that is not there any more would be no mutant
    return lambda: setattr(owner, name, value)


def listens_anywhere():
    import server.app

    server.app.is_loopback = lambda _host: True


def keys_outlive_their_revocation():
    keys.KeyRing.in_force = lambda self, sha256, _now_s: next(
        (key for key in read_keys(self.path) if key.sha256 == sha256), None
    )


def sessions_by_name():
    def by_name(self, cookie, now_s):
        session, kept = self.sessions.find(cookie, now_s), read_keys(self.keys.path)
        names = {key.name for key in kept if session is not None and key.sha256 == session.key_sha256}
        return next((key for key in kept if key.name in names and key.revoked_unix_s is None), None)

    Gatekeeper._by_session = by_name


def keys_outlive_their_file():
    read = keys.KeyRing._read

    def kept(self, path):
        try:
            read(self, path)
        except keys.KeysError:
            return

    keys.KeyRing._read = kept


def write_for_all():
    private = keys.write_private

    def write(path, text):
        private(path, text)
        path.chmod(0o644)

    keys.write_private = write


#: what is taken away: by whom it must be noticed
MUTANTS = {
    "keys are not asked for": (
        put(Gatekeeper, "_identify_caller", lambda *_, **__: ANYBODY),
        "test_no_key_sees_and_moves_nothing_but_may_stop",
    ),
    "roles are not asked for": (
        put(Gatekeeper, "_require_role", lambda _self, caller, *_: caller),
        "test_each_role_does_what_is_its_own",
    ),
    "a fleet may be anybody": (
        put(ControlLog, "check", lambda *_: None),
        "test_a_fleet_key_gets_control_as_a_fleet_only_and_does_not_take_it",
    ),
    "any lease will do": (
        put(LeaseDesk, "check", lambda self, *_: self.held),
        "test_a_stolen_stale_lease_moves_nothing",
    ),
    "answers are not kept": (
        put(job_commands, "replay_of", lambda *_: None),
        "test_a_replayed_command_moves_nothing_a_second_time",
    ),
    "any page may command": (
        put(gatekeeper, "origin_allowed", lambda *_: True),
        "test_a_foreign_origin_commands_nothing",
    ),
    "any name will do": (put(gatekeeper, "host_allowed", lambda *_: True), "test_a_rebound_name_reaches_nothing"),
    "bodies of any length": (
        put(guard, "REQUEST_BODY_MAX_BYTES", 1 << 40),
        "test_an_oversized_body_is_refused_whole_or_in_pieces",
    ),
    "run ids are joined to the folder": (put(runs, "run_path", joined), "test_a_run_id_never_leaves_the_folder"),
    "paths are joined to the folder": (
        put(diagnoses, "path_inside", lambda folder, relative: folder / relative.replace("\x00", "")),
        "test_a_run_id_never_leaves_the_folder",
    ),
    "bodies may take for ever": (put(guard, "_read_whole_body", endless_body), "test_a_slow_body_is_given_up"),
    "headers are logged": (log_headers, "test_no_secret_is_in_log_database_or_answer"),
    "guessing is free": (
        put(Lockout, "locked_s", lambda *_: 0.0),
        "test_six_wrong_keys_lock_the_address_out_but_never_a_stop",
    ),
    "a session outlives its key": (
        keys_outlive_their_revocation,
        "test_a_browser_logs_in_with_a_cookie_that_no_script_and_no_other_site_uses",
    ),
    "a session belongs to a name": (sessions_by_name, "test_a_name_that_is_given_again_revives_no_cookie"),
    "keys outlive their file": (
        keys_outlive_their_file,
        "test_a_key_file_that_cannot_be_read_puts_every_key_out_of_force_but_never_a_stop",
    ),
    "a person may be a fleet": (
        put(lease, "LEASE_KINDS_BY_ROLE", dict.fromkeys(Role, ("operator", "fleet", "engineer"))),
        "test_a_persons_key_gets_no_control_as_a_fleet_and_so_no_motion_without_the_hold",
    ),
    "logging out does nothing": (put(Sessions, "close", lambda *_: None), "test_logging_out_ends_the_session"),
    "it listens anyway": (listens_anywhere, "test_listening_beyond_this_computer_without_keys_does_not_start"),
    "keys are kept as they are": (
        put(keys, "digest_of", lambda key: key),
        "test_a_key_file_holds_no_key_and_is_its_owners",
    ),
    "the key file is everybody's": (write_for_all, "test_a_key_file_holds_no_key_and_is_its_owners"),
}


def pytest_configure() -> None:
    if name := os.environ.get("LONGREACH_MUTANT"):
        MUTANTS[name][0]()
