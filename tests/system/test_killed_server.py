"""SIGKILL in the middle of a move: of the server alone (its link process then stops the PLC), and of everything at once
(then only silence tells the PLC). A relay between both ends sees when the last datagram went and what the PLC did."""

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from longreach.fleet_client import JobClient, JobRefusedError
from longreach.processes import Stack, StackPorts
from machine.description import parse_machine_toml
from protocol.codes import PlcState

sys.path.insert(0, str(Path(__file__).parent))
from kill_client import KillFigures, Relay, figures_table, machine_text, observe_kill

pytestmark = [pytest.mark.system, pytest.mark.real_time, pytest.mark.timeout(240)]
MACHINE = parse_machine_toml(machine_text())
MIDDLE_S = 1.9  # of a retract of 300 mm, which takes about 4 s


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("killed")
    sim = Stack(StackPorts.free(), seed=1, camera_rate_hz=2.0, log_folder=folder / "sim")
    sim.start_sim()
    relay = Relay(sim.ports.plc)
    relay.start()
    yield folder, sim, relay
    relay.close()
    sim.close()


def start_server(folder, sim, relay) -> Stack:
    free = StackPorts.free()
    ports = StackPorts(http=free.http, plc=relay.port, plc_local=free.plc_local, camera=sim.ports.camera)
    server = Stack(ports, runs_folder=folder / "runs", log_folder=folder / f"server-{ports.http}")
    server.start_server()
    with JobClient(server.url) as client:
        client.wait_ready(120.0)
    return server


def drill(bench, kill: Callable[[int], None]) -> KillFigures:
    folder, sim, relay = bench
    server = start_server(folder, sim, relay)
    try:
        body = {"kind": "retract", "distance_mm": 300.0}
        lease = httpx.post(f"{server.url}/v1/lease", json={"owner": "drill", "ttl_s": 60.0}).json()
        held = {"Longreach-Lease": lease["lease_id"], "Longreach-Fencing": str(lease["fencing"])}
        assert httpx.post(f"{server.url}/v1/jobs", json=body, headers=held).status_code == 202
        relay.wait(lambda state: state.plc_state is PlcState.RUN, 20.0, "the retract")
        relay.wait(lambda state: state.t_play_ns >= MIDDLE_S * 1e9, 10.0, "the middle of the retract")
        figures = observe_kill(relay, lambda: kill(server.processes["server"].pid), MACHINE)
    finally:
        server.close()
    print(figures_table([figures]))
    return figures


def check(figures: KillFigures) -> None:
    assert figures.ramp_start_ms <= 270.0  # 260 and a state period: the relay sees states every 10 ms
    assert figures.ramp_ms <= figures.ramp_bound_ms + 12.0
    assert figures.tcp_travel_mm < 150.0


def test_the_server_alone_dies_and_its_link_process_stops_the_machine(bench):
    check(drill(bench, lambda pid: os.kill(pid, signal.SIGKILL)))


def test_server_and_link_die_together_and_silence_stops_the_machine(bench):
    check(drill(bench, lambda pid: os.killpg(pid, signal.SIGKILL)))


def test_after_a_kill_nothing_moves_by_itself_and_a_new_server_finds_the_machine_disarmed(bench):
    folder, sim, relay = bench
    before = relay.states[-1].q
    server = start_server(folder, sim, relay)
    try:
        with JobClient(server.url) as client:
            assert client.state()["link"]["phase"] == "linked"
            assert max(abs(a - b) for a, b in zip(relay.states[-1].q, before, strict=True)) < 1e-3
            with pytest.raises(JobRefusedError, match="look first"):
                client.run({"kind": "preview"})
    finally:
        server.close()
