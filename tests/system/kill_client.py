"""SIGKILL of a small PC end in the middle of a move, without a server; the relay and the figures are the product's.

python tests/system/kill_client.py --preset realistic --n 5        # PC end of this folder, killed n times
observe_kill(relay, kill, machine)                                # any other PC, for instance the whole server
"""

import argparse
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np

from benchmarks.kills.figures import KillFigures, figures_of, figures_table
from benchmarks.kills.plc_process import PlcProcess, free_udp_port
from benchmarks.kills.relay import Relay
from machine.chain import chain_of
from machine.description import Machine, parse_machine_toml
from machine.kinematics import tcp_pose
from protocol.codes import PlcState
from server.settings import read_machine_text
from sim_plc.process import SimSettings

__all__ = ["KillFigures", "Relay", "figures_table", "kill_client", "machine_text", "observe_kill", "simulator"]

ATTEMPTS = 4
PC_END = Path(__file__).with_name("drill_pc.py")


def machine_text() -> str:
    """The shipped machine file."""
    return read_machine_text("hiab033")


def observe_kill(relay: Relay, kill: Callable[[], None], machine: Machine, timeout_s: float = 8.0) -> KillFigures:
    """Kill the PC while the PLC is in RUN, and watch until the machine stands still."""
    relay.wait(lambda state: state.plc_state is PlcState.RUN, timeout_s, "a running trajectory")
    kill()
    relay.wait(lambda state: state.plc_state in (PlcState.HOLD, PlcState.DISARMED), timeout_s, "rest after the kill")
    relay.wait(lambda state: state.plc_state is PlcState.DISARMED, timeout_s, "the session's end")
    time.sleep(1.0)  # what swings goes on swinging for a while
    return figures_of(relay.states, machine)


@contextmanager
def simulator(**settings: object) -> Iterator[tuple[int, BaseProcess]]:
    """A simulator without camera in a process of its own; its UDP port. SIGTERM at the end."""
    port = free_udp_port()
    with PlcProcess(SimSettings(machine_text(), **({"camera": False, "plc_port": port} | settings))) as plc:
        yield port, plc.process


def kill_client(preset: str = "realistic", seed: int = 1, n: int = 3, start_s: float = 90.0) -> list[KillFigures]:
    """Start a simulator; n times: start a PC end, let it arm and move, kill it somewhere in the move's fast part."""
    machine = parse_machine_toml(machine_text())
    tcp_pose(chain_of(machine), np.zeros(len(machine.joints)))  # compiles before the relay must be quick
    figures = []
    with simulator(preset=preset, seed=seed) as (plc_port, _), Relay(plc_port) as relay:
        for number in range(n):
            share = 0.35 + 0.3 * (number + 0.5) / n
            figures.append(_measured_kill(relay, machine, share, start_s))
    return figures


def _measured_kill(relay: Relay, machine: Machine, share: float, start_s: float) -> KillFigures:
    """A kill in the middle of a move. On a computer that stood still for 250 ms the PLC has ended the move by itself,
    rightly, and there was nothing left to kill: that is no measurement, and is made anew.
    """
    for _ in range(ATTEMPTS):
        figures = _one_kill(relay, machine, share, start_s)
        if figures is not None:
            return figures
    raise TimeoutError(
        f"{ATTEMPTS} moves in a row had ended before the kill: this computer is too busy, or the PC end is"
    )


def _one_kill(relay: Relay, machine: Machine, share: float, start_s: float) -> KillFigures | None:
    pc = subprocess.Popen([sys.executable, str(PC_END), str(relay.port)], stdout=subprocess.PIPE, text=True)
    try:
        relay.wait(lambda state: state.plc_state is PlcState.RUN, start_s, "the PC end's move")
        duration_s = float(pc.stdout.readline()) if pc.stdout else 0.0
        until_ns = share * duration_s * 1e9
        state = relay.wait(
            lambda state: state.t_play_ns >= until_ns or state.plc_state is not PlcState.RUN,
            duration_s + 2.0,
            "the middle of the move",
        )
        if state.plc_state is not PlcState.RUN:
            pc.kill()
            relay.wait(lambda state: state.plc_state is PlcState.DISARMED, 8.0, "the session's end")
            return None
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
    print(figures_table(kill_client(**vars(arguments.parse_args()))))
