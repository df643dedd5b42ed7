"""The real server under a stand-in for systemd: it reports ready, alive and stopping, and nothing in a child's name."""

import os
import signal
import socket
import struct
import subprocess
import sys
import time

import httpx
import pytest

from longreach.processes import StackPorts

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]


def test_the_server_reports_ready_alive_and_stopping(tmp_path):
    ports = StackPorts.free()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        environment = {**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "2000000"}
        command = [
            sys.executable,
            "-P",
            "-m",
            "longreach.cli",
            "serve",
            "--port",
            str(ports.http),
            "--runs",
            "runs",
        ]
        command += ["--plc-port", str(ports.plc), "--plc-local-port", str(ports.plc_local)]
        server = subprocess.Popen(command, cwd=tmp_path, env=environment)
        try:
            heard = texts_until(systemd, server.pid, "READY=1")
            assert heard == ["READY=1"]
            assert httpx.get(f"http://127.0.0.1:{ports.http}/healthz", timeout=30.0).status_code == 200
            for _ in range(3):
                texts_until(systemd, server.pid, "WATCHDOG=1")
            assert len(texts_until(systemd, server.pid, "STATUS=")[-1]) > len("STATUS=")  # why no job could start
            server.send_signal(signal.SIGTERM)
            texts_until(systemd, server.pid, "STOPPING=1")
            assert server.wait(60.0) == 0
        finally:
            server.kill()
            server.wait(60.0)


def texts_until(systemd, pid, beginning):
    """What the main process has reported, up to the first report that begins so."""
    found, until_s = [], time.monotonic() + 300.0
    while not found or not found[-1].startswith(beginning):
        systemd.settimeout(until_s - time.monotonic())
        text, ancillary, _flags, _address = systemd.recvmsg(4096, socket.CMSG_SPACE(12))
        assert struct.unpack("3i", ancillary[0][2])[0] == pid  # NotifyAccess=main
        found.append(text.decode())
    return found
