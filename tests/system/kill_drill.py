"""SIGKILL of the PC in the middle of a move: when the ramp starts, how long it takes, how far the tool travels.

A relay stands between PC and PLC and goes on listening when the PC is dead. Everything is measured on the PLC's clock.

    python tests/system/kill_drill.py --preset realistic --n 5        # PC end of this folder, killed n times
    observe_kill(relay, kill, machine)                                # any other PC, for instance the whole server
"""

import argparse
import contextlib
import multiprocessing
import selectors
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from machine.chain import chain_of
from machine.description import Machine, parse_machine_toml
from machine.kinematics import tcp_pose
from protocol.codec import decode_state
from protocol.codes import PlcState
from protocol.messages import State
from sim_plc.process import SimSettings, run_sim

PC_END = Path(__file__).with_name("drill_pc.py")
STILL_RAD_S = 0.003  # encoders: the boom has stopped swinging


def machine_text() -> str:
    """The shipped machine file."""
    return (files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8")


class Relay(threading.Thread):
    """Passes datagrams between a PC, which sends to `port`, and a PLC; keeps the PLC's states."""

    def __init__(self, plc_port: int) -> None:
        super().__init__(daemon=True)
        self._front, self._back = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._front.bind(("127.0.0.1", 0))
        self._back.connect(("127.0.0.1", plc_port))
        self.port = self._front.getsockname()[1]
        self.states: list[State] = []
        self.t_last_command_ns = 0  # monotonic
        self._pc: tuple[str, int] | None = None
        self._stopped = threading.Event()

    def run(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._front, selectors.EVENT_READ, self._from_pc)
            selector.register(self._back, selectors.EVENT_READ, self._from_plc)
            while not self._stopped.is_set():
                for key, _ in selector.select(0.1):
                    with contextlib.suppress(ConnectionError):  # one of both is not there (any more)
                        key.data()
        self._front.close()
        self._back.close()

    def close(self) -> None:
        self._stopped.set()
        self.join()

    def _from_pc(self) -> None:
        datagram, self._pc = self._front.recvfrom(4096)
        self.t_last_command_ns = time.monotonic_ns()
        self._back.send(datagram)

    def _from_plc(self) -> None:
        datagram = self._back.recv(4096)
        self.states.append(decode_state(datagram))
        if self._pc is not None:
            self._front.sendto(datagram, self._pc)

    def wait(self, wanted: Callable[[State], bool], timeout_s: float, what: str) -> State:
        """The newest state as soon as it is as wanted."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            if self.states and wanted(self.states[-1]):
                return self.states[-1]
            time.sleep(0.002)
        newest = self.states[-1].plc_state.name if self.states else "no state at all"
        raise TimeoutError(f"{what}: not within {timeout_s} s; the PLC said {newest}")


@dataclass(frozen=True, slots=True)
class KillFigures:
    """One kill. Times count from the last command that the PLC accepted."""

    ramp_start_ms: float
    reference_at_rest_ms: float
    ramp_ms: float
    ramp_bound_ms: float  # max |qd| / qdd_stop at the start of the ramp
    machine_still_ms: float
    tcp_speed_mm_s: float  # when the ramp started
    tcp_travel_mm: float  # from the last command to standstill, by encoders and nominal kinematics
    tcp_ramp_mm: float  # of it from the start of the ramp


def observe_kill(relay: Relay, kill: Callable[[], None], machine: Machine, timeout_s: float = 8.0) -> KillFigures:
    """Kill the PC while the PLC is in RUN, and watch until the machine stands still."""
    relay.wait(lambda state: state.plc_state is PlcState.RUN, timeout_s, "a running trajectory")
    kill()
    relay.wait(lambda state: state.plc_state in (PlcState.HOLD, PlcState.DISARMED), timeout_s, "rest after the kill")
    relay.wait(lambda state: state.plc_state is PlcState.DISARMED, timeout_s, "the session's end")
    time.sleep(1.0)  # what swings goes on swinging for a while
    return figures_of(relay.states, machine)


def figures_of(states: list[State], machine: Machine) -> KillFigures:
    """The figures from the PLC's states of the newest stop: RUN, STOPPING, HOLD.

    The state comes every 10 ms; the start of the ramp is where the reference's speed before and in the ramp, both taken
    as straight lines over two states, meet. The end is the first state at rest: up to 10 ms late.
    """
    chain, n = chain_of(machine), len(machine.joints)
    first = max(i for i, state in enumerate(states) if state.plc_state is PlcState.RUN) + 1
    ramp = states[first]
    if ramp.plc_state is not PlcState.STOPPING:
        raise ValueError(f"after RUN came {ramp.plc_state.name}: the trajectory had ended before the kill")
    rest = next(state for state in states[first:] if state.plc_state is not PlcState.STOPPING)
    qdd_stop = np.array([joint.qdd_max_rad_s2 for joint in machine.joints])
    joint = int(np.argmax(np.abs(ramp.qd_ref[:n]) / qdd_stop))
    t_ramp_ns = _meeting_ns(states[first - 2 : first + 2], joint)
    t_command_ns = states[first - 1].t_send_ns - states[first - 1].rx_age_us * 1000
    speed = np.abs(np.array(states[first - 1].qd_ref[:n]))
    poses = {state.t_send_ns: tcp_pose(chain, np.array(state.q[:n]))[:3, 3] for state in states[first - 60 :]}
    times = np.array(list(poses))
    path = np.array(list(poses.values()))
    moving = [state.t_send_ns for state in states[first:] if np.abs(state.qd[:n]).max() > STILL_RAD_S]
    i_command, i_ramp = (int(np.searchsorted(times, t)) for t in (t_command_ns, t_ramp_ns))
    return KillFigures(
        ramp_start_ms=(t_ramp_ns - t_command_ns) / 1e6,
        reference_at_rest_ms=(rest.t_send_ns - t_command_ns) / 1e6,
        ramp_ms=(rest.t_send_ns - t_ramp_ns) / 1e6,
        ramp_bound_ms=float((speed / qdd_stop).max()) * 1e3,
        machine_still_ms=(max(moving, default=rest.t_send_ns) - t_command_ns) / 1e6,
        tcp_speed_mm_s=float(
            np.linalg.norm(path[i_ramp] - path[i_ramp - 3]) / (times[i_ramp] - times[i_ramp - 3]) * 1e12
        ),
        tcp_travel_mm=float(np.linalg.norm(path[-1] - path[i_command])) * 1e3,
        tcp_ramp_mm=float(np.linalg.norm(path[-1] - path[i_ramp])) * 1e3,
    )


def _meeting_ns(four: list[State], joint: int) -> int:
    """Where the lines through the first and the last two speeds of a joint meet, between the middle two."""
    t = np.array([state.t_send_ns - four[1].t_send_ns for state in four], dtype=float)
    v = np.array([state.qd_ref[joint] for state in four])
    slope_run, slope_ramp = (v[1] - v[0]) / (t[1] - t[0]), (v[3] - v[2]) / (t[3] - t[2])
    if slope_run == slope_ramp:
        return four[2].t_send_ns
    meeting = (v[2] - slope_ramp * t[2] - v[1]) / (slope_run - slope_ramp)
    return four[1].t_send_ns + round(min(max(meeting, t[1]), t[2]))


def figures_table(figures: list[KillFigures]) -> str:
    """A table in Markdown."""
    head = (
        "| kill | ramp starts ms | reference at rest ms | ramp ms | bound ms | still ms "
        "| TCP mm/s | TCP travel mm | from ramp on mm |"
    )
    rows = [
        f"| {i} | {f.ramp_start_ms:.0f} | {f.reference_at_rest_ms:.0f} | {f.ramp_ms:.0f} | {f.ramp_bound_ms:.0f} "
        f"| {f.machine_still_ms:.0f} | {f.tcp_speed_mm_s:.0f} | {f.tcp_travel_mm:.1f} | {f.tcp_ramp_mm:.1f} |"
        for i, f in enumerate(figures, start=1)
    ]
    return "\n".join([head, "|" + "---|" * 9, *rows])


@contextmanager
def simulator(**settings: object) -> Iterator[tuple[int, multiprocessing.process.BaseProcess]]:
    """A simulator without camera in a process of its own; its UDP port. SIGTERM at the end."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    chosen = SimSettings(machine_text(), **({"camera": False, "plc_port": port} | settings))
    process = multiprocessing.get_context("spawn").Process(target=run_sim, args=(chosen,))
    process.start()
    try:
        yield port, process
    finally:
        process.terminate()
        process.join(15.0)
        if process.is_alive():
            process.kill()
            process.join()


def kill_drill(preset: str = "realistic", seed: int = 1, n: int = 3, start_s: float = 90.0) -> list[KillFigures]:
    """Start a simulator; n times: start a PC end, let it arm and move, kill it somewhere in the move's fast part."""
    machine = parse_machine_toml(machine_text())
    tcp_pose(chain_of(machine), np.zeros(len(machine.joints)))  # compiles before the relay must be quick
    figures = []
    with simulator(preset=preset, seed=seed) as (plc_port, _):
        relay = Relay(plc_port)
        relay.start()
        try:
            for number in range(n):
                share = 0.35 + 0.3 * (number + 0.5) / n
                figures.append(_one_kill(relay, machine, share, start_s))
        finally:
            relay.close()
    return figures


def _one_kill(relay: Relay, machine: Machine, share: float, start_s: float) -> KillFigures:
    pc = subprocess.Popen([sys.executable, str(PC_END), str(relay.port)], stdout=subprocess.PIPE, text=True)
    try:
        relay.wait(lambda state: state.plc_state is PlcState.RUN, start_s, "the PC end's move")
        duration_s = float(pc.stdout.readline()) if pc.stdout else 0.0
        until_ns = share * duration_s * 1e9
        relay.wait(lambda state: state.t_play_ns >= until_ns, duration_s + 2.0, "the middle of the move")
        return observe_kill(relay, lambda: pc.send_signal(signal.SIGKILL), machine)
    finally:
        pc.kill()
        pc.wait()
        if pc.stdout:
            pc.stdout.close()


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--preset", default="realistic")
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--n", type=int, default=3)
    print(figures_table(kill_drill(**vars(arguments.parse_args()))))
