"""The simulator as real processes: UDP, a killed PC, a clean end, the camera beside it."""

import multiprocessing
import os
import signal
import socket
import time
from pathlib import Path

import httpx
import numpy as np
import pytest
from drill_pc import received
from kill_client import figures_table, kill_client, machine_text, simulator

from machine.description import parse_machine_toml
from protocol.client_link import ClientLink
from protocol.codes import HeaderFlag, PlcState
from protocol.framing import EapFraming
from protocol.limits import limits_of
from recording.clock import mono_ns
from sim_plc.process import SimSettings, run_sim

pytestmark = [pytest.mark.system, pytest.mark.timeout(240)]
READY_S = 90.0  # the first start on a machine compiles the plant


def shared_memories_of(pid):
    """Shared memories that a process has mapped (Linux)."""
    maps = Path(f"/proc/{pid}/maps")
    lines = maps.read_text().splitlines() if maps.exists() else []
    return {Path(line.split()[-1]) for line in lines if "/dev/shm/psm_" in line}


@pytest.mark.real_time
def test_a_killed_pc_makes_the_plc_ramp_to_a_hold_in_time():
    figures = kill_client("realistic", seed=1, n=2)
    print("\n" + figures_table(figures))
    for kill in figures:
        assert 100.0 < kill.ramp_start_ms <= 260.0
        assert kill.ramp_ms <= kill.ramp_bound_ms + 12.0  # a state comes every 10 ms
        assert kill.tcp_speed_mm_s > 50.0
        assert kill.tcp_travel_mm < 250.0
        assert kill.machine_still_ms < 4000.0


def test_it_arms_over_eap_and_ends_cleanly_on_sigterm():
    framing = EapFraming.for_client("192.168.0.10.1.1", "192.168.0.20.1.1")
    link = ClientLink(limits_of(parse_machine_toml(machine_text()).joints), framing, session=11)
    link.request_arm()
    with simulator(preset="ideal", framing="eap") as (port, process), socket.socket(type=socket.SOCK_DGRAM) as udp:
        udp.setblocking(False)
        deadline = time.monotonic() + READY_S
        while not (link.linked and link.state.plc_state is PlcState.HOLD):
            assert time.monotonic() < deadline, link.last_reject
            received(udp, link)
            datagram = link.send(mono_ns())
            if datagram:
                udp.sendto(datagram, ("127.0.0.1", port))
            time.sleep(0.02)
        assert HeaderFlag.SIMULATION in link.state.flags
        assert np.isfinite(link.state.q).all()
        mapped = shared_memories_of(process.pid)
        process.terminate()
        process.join(10.0)
        assert process.exitcode == 0
    assert not any(memory.exists() for memory in mapped)


def test_two_simulators_cannot_share_a_port():
    with socket.socket(type=socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        settings = SimSettings(machine_text(), preset="ideal", camera=False, plc_port=taken.getsockname()[1])
        process = multiprocessing.get_context("spawn").Process(target=run_sim, args=(settings,))
        process.start()
        process.join(READY_S)
        assert process.exitcode == 1


def test_plc_and_camera_start_together_and_end_together():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with simulator(preset="ideal", camera=True, camera_port=port, camera_rate_hz=5.0) as (_, process):
        assert wait_for_picture(port)
        os.kill(process.pid, signal.SIGINT)
        process.join(15.0)
        assert process.exitcode == 0
    with pytest.raises(httpx.TransportError):
        httpx.get(f"http://127.0.0.1:{port}/healthz", timeout=2.0)


def wait_for_picture(port):
    deadline = time.monotonic() + READY_S
    while time.monotonic() < deadline:
        try:
            health = httpx.get(f"http://127.0.0.1:{port}/healthz", timeout=2.0).json()
        except httpx.TransportError:
            time.sleep(0.2)
            continue
        if health["frames"] > 3:
            return True
        time.sleep(0.2)
    return False
