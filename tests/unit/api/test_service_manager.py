"""The reports to systemd, received at a socket as systemd's own: sd_notify(3)."""

import asyncio
import os
import re
import shutil
import socket
import subprocess
from pathlib import Path

import pytest

from server import service_manager as module
from server.service_manager import ServiceManager

ROOT = Path(__file__).parents[3]
UNIT = ROOT / "docs" / "deploy" / "longreach.service"


@pytest.fixture(params=["path", "abstract"])
def systemd(request: pytest.FixtureRequest, tmp_path: Path):
    """The receiving socket, and its address as systemd writes it into the environment."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(str(tmp_path / "notify") if request.param == "path" else f"\0longreach-{os.getpid()}")
        receiver.setblocking(False)
        name = receiver.getsockname()
        yield receiver, name if isinstance(name, str) else "@" + name[1:].decode()


def heard(receiver: socket.socket) -> list[str]:
    found = []
    while True:
        try:
            found.append(receiver.recv(4096).decode())
        except BlockingIOError:
            return found


async def test_ready_alive_with_its_status_and_stopping(systemd, monkeypatch) -> None:
    receiver, address = systemd
    environment = {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "100000", "WATCHDOG_PID": str(os.getpid()), "HOME": "/"}
    reasons = ["camera: \n no picture"]
    manager = ServiceManager.of_environment(lambda: reasons[0], environment)
    assert environment == {"HOME": "/"}  # no child process reports in our name
    manager.ready()
    alive = asyncio.create_task(manager.keep_alive())
    async with asyncio.timeout(30.0):
        texts = heard(receiver)
        while texts.count("WATCHDOG=1") < 3:
            await asyncio.sleep(0.01)
            texts += heard(receiver)
    assert texts[0] == "READY=1"
    assert "STATUS=camera: no picture" in texts
    manager.stopping()
    texts = heard(receiver)
    async with asyncio.timeout(30.0):
        while texts[-1] != "WATCHDOG=1" or not any("STOPPING=1" in text for text in texts):
            await asyncio.sleep(0.01)
            texts += heard(receiver)
    stopping = next(number for number, text in enumerate(texts) if text.startswith("STOPPING=1\nSTATUS=stopping"))
    assert set(texts[stopping + 1 :]) == {"WATCHDOG=1"}
    alive.cancel()


@pytest.mark.parametrize(
    ("environment", "watchdog_s"),
    [
        ({"WATCHDOG_USEC": "30000000"}, 30.0),
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "1"}, None),  # of another process
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({}, None),
    ],
)
def test_the_watchdog_is_ours_or_none(environment, watchdog_s) -> None:
    assert ServiceManager.of_environment(str, dict(environment))._watchdog_s == watchdog_s


async def test_without_systemd_nothing_is_sent_and_nothing_runs() -> None:
    manager = ServiceManager.of_environment(str, {})
    manager.ready()
    manager.stopping()
    async with asyncio.timeout(30.0):
        await manager.keep_alive()


async def test_a_status_that_fails_and_a_socket_that_is_gone_disturb_nothing(systemd, caplog) -> None:
    receiver, address = systemd

    def broken() -> str:
        raise ValueError("no state")

    alive = asyncio.create_task(ServiceManager(address, 0.05, broken).keep_alive())
    async with asyncio.timeout(30.0):
        texts: list[str] = []
        while texts.count("WATCHDOG=1") < 3:
            await asyncio.sleep(0.01)
            texts += heard(receiver)
    assert "STATUS=status unknown: ValueError('no state')" in texts
    alive.cancel()
    lost = ServiceManager("/nowhere/notify", None, str)
    for _ in range(3):
        lost.ready()
    assert caplog.text.count("systemd cannot be informed at /nowhere/notify") == 1


def test_the_unit_file_is_of_this_protocol_and_of_these_options() -> None:
    unit = UNIT.read_text(encoding="utf-8")
    values = dict(re.findall(r"^(\w+)=(.*)$", unit, re.MULTILINE))
    assert values["Type"] == "notify"
    assert values["KillMode"] == "mixed"  # SIGTERM to the main process alone: it ramps the machine down
    assert float(values["WatchdogSec"]) >= 2.0 * module.STATUS_PERIOD_MAX_S
    options = set(re.findall(r"--[\w-]+", values["ExecStart"]))
    reference = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")
    assert options
    assert options <= set(re.findall(r"--[\w-]+", reference))


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_systemd_accepts_the_unit_file(tmp_path: Path) -> None:
    """The program's path is that of an installation; here it is one that exists."""
    text = re.sub(r"/opt/longreach/bin/longreach", "/bin/true", UNIT.read_text(encoding="utf-8"))
    (unit := tmp_path / "longreach.service").write_text(text, encoding="utf-8")
    done = subprocess.run(["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, check=False)
    assert not [line for line in done.stderr.splitlines() if "longreach.service" in line]
