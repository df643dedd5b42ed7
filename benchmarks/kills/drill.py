"""One kill in the middle of a real job: own processes, one retract, one SIGKILL, a restart, one more retract."""

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.kills.case import VICTIMS, KillCase, Observed, Victim, judged
from benchmarks.kills.plc_process import PlcProcess, free_udp_port
from benchmarks.kills.relay import Relay
from benchmarks.kills.under_test import START_S, ServerUnderTest
from machine.description import Machine, parse_machine_toml
from protocol.codes import PlcState
from recording.files import read_text
from server.settings import read_machine_text
from sim_plc.process import SimSettings

RETRACT_MM = 400.0
TCP_SPEED_M_S = 0.15
_PLANNED_SHARE = 0.8  # as server.jobs.plans.planning.LIMIT_SHARE: what a plan uses of the machine's TCP speed limit
MOMENTS = (0.15, 0.85)  # of the move, in which the kill falls
WORLD_SEED = 1  # the move is the same every time, the moment is not
WATCH_S = 1.5  # after the restart, to see that nothing moves by itself
SWING_S = 1.0  # the boom swings for a while after the reference rests
JOB_END_S = 6.0
AGAIN_MM = 30.0


def run_case(victim: Victim, number: int, seed: int, folder: Path) -> KillCase:
    """One case; what it needs is written into the folder, and logs of the server.

    Raises: TimeoutError, RuntimeError: it did not come to the kill, or not back from it; says what was missing.
    """
    started_s = time.monotonic()
    rng = np.random.default_rng([seed, VICTIMS.index(victim), number])
    moment = float(rng.uniform(*MOMENTS))
    folder.mkdir(parents=True, exist_ok=True)
    machine_file, machine = fast_machine(folder)
    text = read_text(machine_file)
    settings = SimSettings(text, seed=WORLD_SEED, plc_port=free_udp_port(), camera=False)
    with PlcProcess(settings) as plc, Relay(settings.plc_port) as relay:
        server = ServerUnderTest(relay.port, machine_file, folder)
        try:
            drill = _Drill(victim, plc, relay, server, machine)
            drill.move(moment)
            drill.kill()
            drill.restart()
            drill.watch()
            drill.move_again()
        finally:
            server.close()
    return judged(victim, number, seed, moment, drill.observed(), time.monotonic() - started_s)


def fast_machine(folder: Path) -> tuple[Path, Machine]:
    """The shipped machine with the TCP speed limit at which planned moves reach 0.15 m/s; a file for both ends."""
    text = read_machine_text("hiab033")
    before, wanted = parse_machine_toml(text).tcp_speed_max_m_s, TCP_SPEED_M_S / _PLANNED_SHARE
    text = text.replace(f"tcp_speed_max_m_s = {before}", f"tcp_speed_max_m_s = {wanted}")
    machine = parse_machine_toml(text)
    if machine.tcp_speed_max_m_s != wanted:
        raise RuntimeError(f"'tcp_speed_max_m_s = {before}' is not in the machine file; it must be written so")
    path = (folder / "machine.toml").resolve()
    path.write_text(text, encoding="utf-8")
    return path, machine


@dataclass(slots=True)
class _Drill:
    """The steps of one case, in their order, and what was seen on the way."""

    victim: Victim
    plc: PlcProcess
    relay: Relay
    server: ServerUnderTest
    machine: Machine
    job_id: str = ""
    planned_s: float = 0.0
    t_kill_s: float = 0.0
    job_ended_s: float | None = None
    job: dict[str, Any] = field(default_factory=dict)
    again: dict[str, Any] = field(default_factory=dict)
    i_stopped: int = 0  # states before this one belong to the move and its ramp
    i_quiet: int = 0  # from here on nothing may move
    i_again: int = 0  # until here

    def move(self, moment: float) -> None:
        """Start everything and the retract; return at that share of it."""
        self.server.start()
        self.relay.wait(lambda state: state.plc_state is PlcState.LINKED, START_S, "the link")
        self.job_id = self.server.start_job({"kind": "retract", "distance_mm": RETRACT_MM, "owner": "kill drill"})
        self.planned_s = self.server.planned_s(self.job_id, 20.0)
        self.relay.wait(lambda state: state.plc_state is PlcState.RUN, 10.0, "the retract")
        at_ns = moment * self.planned_s * 1e9
        self.relay.wait(lambda state: state.t_play_ns >= at_ns, self.planned_s + 2.0, "the moment of the kill")

    def kill(self) -> None:
        """Kill, and watch until the machine stands still and the session is over."""
        match self.victim:
            case "server":
                self.server.kill()
            case "all":
                self.server.kill_all()
            case "link":
                self.server.kill_link()
            case "plc":
                self.plc.kill()
        self.t_kill_s = time.monotonic()
        self.i_stopped = len(self.relay.states)
        if self.victim in ("link", "plc"):
            self.job = self.server.wait_ended(self.job_id, JOB_END_S)
            self.job_ended_s = time.monotonic() - self.t_kill_s
        if self.victim != "plc":
            self._wait_for_rest()

    def _wait_for_rest(self) -> None:
        """Looks at all states since the kill: a link that comes back quickly leaves none of them for long."""
        deadline = time.monotonic() + 8.0
        while not any(state.plc_state is PlcState.DISARMED for state in self.relay.states[self.i_stopped :]):
            if time.monotonic() > deadline:
                raise TimeoutError(f"PLC not disarmed after the kill; it says {self.relay.states[-1].plc_state.name}")
            time.sleep(0.01)
        time.sleep(SWING_S)
        self.i_stopped = len(self.relay.states)

    def restart(self) -> None:
        """Bring back what was killed: by hand, or (the link) by itself."""
        self.i_quiet = len(self.relay.states)
        match self.victim:
            case "server" | "all":
                self.server.close()
                self.server.start()
                self.job = self.server.job(self.job_id)
            case "plc":
                self.plc.start()
                self.relay.wait(lambda _: len(self.relay.states) > self.i_quiet, START_S, "a state of the new PLC")
        self.server.wait_linked(START_S)

    def watch(self) -> None:
        """Let time pass in which nothing may happen."""
        time.sleep(WATCH_S)
        self.i_again = len(self.relay.states)

    def move_again(self) -> None:
        """A new job, which must arm, ends well."""
        body = {"kind": "retract", "distance_mm": AGAIN_MM, "owner": "kill drill"}
        self.again = self.server.wait_ended(self.server.start_job(body), 20.0)

    def observed(self) -> Observed:
        """What there is to judge."""
        states = self.relay.states
        return Observed(
            machine=self.machine,
            planned_s=self.planned_s,
            move=tuple(states[: self.i_stopped]),
            quiet=tuple(states[self.i_quiet : self.i_again]),
            after=tuple(states[self.i_again :]),
            job=self.job,
            job_ended_s=self.job_ended_s,
            again=self.again,
        )
