"""Roles, lock-out, hosts: the tables themselves."""

import pytest

from server.access.gatekeeper import LOGIN_FAILURES_MAX, LOGIN_LOCKOUT_S, TRACKED_ADDRESSES_MAX, Lockout
from server.access.hosts import host_allowed, is_loopback, origin_allowed
from server.access.roles import ANYBODY, COMMANDING_ROLES, EVERY_ROLE, HUMAN_ROLES, roles_needed


@pytest.mark.parametrize(
    ("method", "path", "roles"),
    [
        ("POST", "/v1/stop", ANYBODY),
        ("GET", "/healthz", ANYBODY),
        ("HEAD", "/healthz", ANYBODY),
        ("POST", "/v1/session", ANYBODY),
        ("TRACE", "/v1/stop", EVERY_ROLE),
        ("PUT", "/v1/stop", EVERY_ROLE),
        ("GET", "/v1/session", EVERY_ROLE),
        ("DELETE", "/v1/session", EVERY_ROLE),
        ("GET", "/v1/state", EVERY_ROLE),
        ("POST", "/v1/jobs/abc/cancel", EVERY_ROLE),
        ("POST", "/v1/jobs", COMMANDING_ROLES),
        ("PUT", "/v1/lease/abc", COMMANDING_ROLES),
        ("POST", "/v1/disarm", COMMANDING_ROLES),
        ("POST", "/v1/jobsmith", HUMAN_ROLES),
        ("POST", "/v1/diagnoses", HUMAN_ROLES),
        ("PUT", "/v1/whatever-comes", HUMAN_ROLES),
        ("GET", "/v1/audit", HUMAN_ROLES),
        ("GET", "/v1/hold", HUMAN_ROLES),
        ("POST", "/v1/stop/", HUMAN_ROLES),
    ],
)
def test_who_may_what_and_what_is_not_listed_takes_a_person(method, path, roles):
    assert roles_needed(method, path) == roles


def test_six_failures_lock_for_a_minute_and_a_minute_of_peace_forgets():
    lockout = Lockout()
    for number in range(LOGIN_FAILURES_MAX):
        assert lockout.locked_s("a", float(number)) == 0.0
        lockout.count_failure("a", float(number))
    assert lockout.locked_s("a", 5.0) == LOGIN_LOCKOUT_S
    assert lockout.locked_s("b", 5.0) == 0.0
    assert lockout.locked_s("a", 5.0 + LOGIN_LOCKOUT_S) == 0.0
    lockout.count_failure("a", 6.0 + LOGIN_LOCKOUT_S)
    assert lockout.locked_s("a", 6.0 + LOGIN_LOCKOUT_S) == 0.0
    lockout.clear_failed_attempts("a")
    for number in range(TRACKED_ADDRESSES_MAX + 10):
        lockout.count_failure(f"address {number}", 0.0)
    assert len(lockout._failed) == TRACKED_ADDRESSES_MAX


@pytest.mark.parametrize(
    ("host", "allowed"),
    [
        ("127.0.0.1:8080", True),
        ("localhost", True),
        ("[::1]:8080", True),
        ("192.168.1.5", True),
        ("crane-7:8080", True),
        ("evil.example", False),
        ("", False),
        ("localhost.evil.example", False),
        ("crane-7.evil.example", False),
        ("[", False),
    ],
)
def test_a_host_is_an_address_or_a_name_of_ours(host, allowed):
    assert host_allowed(host, ("crane-7",)) is allowed


def test_origins_and_loopback():
    assert origin_allowed(None, "crane-7")
    assert origin_allowed("https://crane-7", "crane-7")
    assert not origin_allowed("https://crane-8", "crane-7")
    assert not origin_allowed("null", "crane-7")
    assert [is_loopback(host) for host in ("127.0.0.1", "::1", "localhost", "0.0.0.0", "::", "crane-7")] == [
        True,
        True,
        True,
        False,
        False,
        False,
    ]
