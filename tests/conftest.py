"""Tests of real processes are run again where they failed while this computer stood still; how often is told."""

import time

import pytest
from _pytest.runner import runtestprotocol
from hypothesis import HealthCheck, settings

from tests.standing_still import StandstillWatch

REAL = ("loop", "system")  # folders whose tests run in real time
TRIES = 3
_watch = pytest.StashKey[StandstillWatch]()
_told = pytest.StashKey[list[str]]()
settings.register_profile("longreach", deadline=None, suppress_health_check=[HealthCheck.too_slow])  # never by timing
settings.load_profile("longreach")


def pytest_configure(config):
    config.stash[_told] = []


def pytest_unconfigure(config):
    if _watch in config.stash:
        config.stash[_watch].close()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item, nextitem):
    if item.path.parent.name not in REAL:
        return None
    stash = item.config.stash
    if _watch not in stash:
        stash[_watch] = StandstillWatch()
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    reports = []
    for left in reversed(range(TRIES)):
        begun_s = time.monotonic()
        reports = runtestprotocol(item, nextitem=nextitem, log=False)
        stood_s = stash[_watch].longest_s(begun_s)
        if left == 0 or stood_s == 0.0 or not any(one.when == "call" and one.failed for one in reports):
            break
        stash[_told].append(
            f"{item.nodeid}: failed while this computer stood still for {1e3 * stood_s:.0f} ms; run again"
        )
    for one in reports:
        item.ihook.pytest_runtest_logreport(report=one)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def pytest_terminal_summary(terminalreporter, config):
    for line in config.stash[_told]:
        terminalreporter.write_line(line)
