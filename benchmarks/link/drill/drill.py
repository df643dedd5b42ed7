"""One fault schedule in virtual time: the real PC end, a misbehaving network, the real PLC program, a watch on it."""

import random
from collections import Counter
from dataclasses import asdict, dataclass, field, replace
from importlib.resources import files

import numpy as np

from benchmarks.link.drill.drill_plant import DrillPlant, IdealPlant
from benchmarks.link.drill.invariants import Breach, Longest, Watch
from benchmarks.link.drill.operator import Operator
from benchmarks.link.drill.schedule import Act, Action, FaultPhase, FaultSchedule
from machine.description import Machine, parse_machine_toml
from protocol.client_events import ClientEvent, LinkClosed, TailAnswered, TrajectoryEnded
from protocol.client_link import ClientLink
from protocol.codec import decode_command, encode_command
from protocol.codes import Mode
from protocol.framing import RawFraming
from protocol.limits import limits_of
from protocol.timeouts import COMMAND_PERIOD, LINK_CLOSE_TIMEOUT, MS, STATE_PERIOD
from sim_plc.plc.local_panel import LocalPanel
from sim_plc.plc.logic import PlcLogic
from sim_plc.plc.reference import Motion
from sim_plc.relay.faults import FaultChannel, FaultCounts, Faults

_FRAMING = RawFraming()
_Q_START_DEG = (10.0, 40.0, -80.0, 5.0, -40.0, 3.0)
_SETTLE_NS = 60 * MS
_ROUNDING_RAD = 1e-9
_LONGEST_RAMP_NS = 2000 * MS


def drill_machine(cycle_ms: int, name: str = "hiab033") -> Machine:
    """A shipped machine whose PLC runs at that cycle."""
    text = (files("machine") / "machines" / f"{name}.toml").read_text(encoding="utf-8")
    return replace(parse_machine_toml(text), plc_cycle_s=cycle_ms * 1e-3)


@dataclass(frozen=True, slots=True)
class DrillResult:
    """What one drill has shown. `worst`: per motion the largest shares of the limits, see invariants.measure."""

    seed: int
    breaches: list[Breach]
    worst: dict[str, list[float]]
    to_plc: FaultCounts
    to_pc: FaultCounts
    virtual_s: float
    seconds_in: dict[str, float]
    starts: int
    reached: int
    ended_early: int
    tails: int
    servos: int
    sessions: int
    faults: dict[str, int]
    underruns: int
    longest: Longest


@dataclass(slots=True)
class Drill:
    """Call `run` once. `t_ns` is the time of the drill; PC and PLC have clocks of their own."""

    schedule: FaultSchedule
    machine: Machine
    plant: DrillPlant
    t_ns: int = 0
    to_plc: FaultChannel = field(init=False)
    to_pc: FaultChannel = field(init=False)
    plc: PlcLogic = field(init=False)
    client: ClientLink = field(init=False)
    watch: Watch = field(init=False)
    operator: Operator = field(init=False)
    panel: LocalPanel = field(init=False)
    breaches: list[Breach] = field(default_factory=list)
    ended: list[tuple[int, TrajectoryEnded]] = field(default_factory=list)
    ended_at: dict[tuple[int, int], tuple[float, ...]] = field(default_factory=dict)
    sessions: int = 0
    underruns: int = 0
    _rng: random.Random = field(init=False)
    _worst: np.ndarray = field(default_factory=lambda: np.zeros((len(Motion), 4)))
    _cycles_in: Counter[str] = field(default_factory=Counter)
    _faults: Counter[str] = field(default_factory=Counter)
    _until: dict[str, int] = field(default_factory=dict)  # what lasts, until when
    _instead: tuple[Mode, int] | None = None  # commands of this mode go out instead, until then
    _phases: list[FaultPhase] = field(default_factory=list)
    _actions: list[Action] = field(default_factory=list)
    _pc_source: int = 0
    _pc_dead: bool = False
    _plc_epoch_ns: int = 0
    _pc_epoch_ns: int = 0
    _starts: int = 0
    _longest: Longest = field(default_factory=Longest)

    def __post_init__(self) -> None:
        schedule = self.schedule
        self._rng = random.Random(f"drill {schedule.seed}")
        self.to_plc = FaultChannel(Faults(), random.Random(f"to plc {schedule.seed}"))
        self.to_pc = FaultChannel(Faults(), random.Random(f"to pc {schedule.seed}"))
        self.panel = LocalPanel("panel" if schedule.panel else "auto")
        table = limits_of(self.machine.joints)
        self.operator = Operator(table, self.panel, random.Random(f"operator {schedule.seed}"))
        self._phases, self._actions = list(schedule.phases), list(schedule.actions)
        self._pc_epoch_ns = self._rng.randrange(1 << 50)
        self._start_plc()
        self._connect()

    # --- the whole drill ---------------------------------------------------------------------------------------------

    def run(self) -> DrillResult:
        """To the end of the schedule, then silence until the PLC must be disarmed and at rest."""
        end_ns = round(self.schedule.length_s * 1e9)
        while self.t_ns < end_ns:
            self.step()
        self._fall_silent()
        halted_ns = self._until.get("plc stall", self.t_ns)  # a halted program can do nothing before it runs again
        end_ns = max(self.t_ns + LINK_CLOSE_TIMEOUT.duration_ns, halted_ns) + _SETTLE_NS
        give_up_ns = end_ns + _LONGEST_RAMP_NS
        while self.t_ns < end_ns or (self.plc.reference.motion is not Motion.FOLLOW and self.t_ns < give_up_ns):
            self.step()
        self.watch.at_end()
        self._close_watch()
        self._judge_ends()
        return self._result()

    def step(self) -> None:
        """One PLC cycle."""
        cycle_ms = self.schedule.cycle_ms
        self.t_ns += cycle_ms * MS
        while self._phases and self._phases[0].t_s * 1e9 <= self.t_ns:
            phase = self._phases.pop(0)
            self.to_plc.faults, self.to_pc.faults = phase.to_plc, phase.to_pc
        while self._actions and self._actions[0].t_s * 1e9 <= self.t_ns:
            self._act(self._actions.pop(0))
        if self._until:
            self._end_what_is_over()
        if "plc stall" not in self._until:
            self._cycle_plc(cycle_ms)
        if "pc stall" not in self._until:
            self._cycle_pc()

    # --- the two ends ------------------------------------------------------------------------------------------------

    def _start_plc(self) -> None:
        """Program start: its clock begins anew somewhere, it has forgotten everything."""
        self._plc_epoch_ns = self._rng.randrange(1 << 50) - self.t_ns % MS
        nonces = random.Random(self._rng.getrandbits(64))
        self.plc = PlcLogic(self.machine, _FRAMING, lambda: nonces.getrandbits(32), self.panel)
        self.watch = Watch(self.plc, self.breaches, self._worst, self._cycles_in, self.operator.asked, self.ended_at)

    def _connect(self) -> None:
        self.sessions += 1
        session = self._rng.randrange(1, 1 << 32)
        self.client = ClientLink(self.plc.settings.limit_table, _FRAMING, session)
        self.operator.begin_anew()

    def _cycle_plc(self, cycle_ms: int) -> None:
        t_plc_ns, watch = self.t_ns + self._plc_epoch_ns, self.watch
        watch.t_s = self.t_ns * 1e-9
        for datagram in self.to_plc.pop(self.t_ns):
            watch.events(self.plc.receive(datagram, t_plc_ns, self._pc_source), t_plc_ns)
        valves = self.plc.run_cycle(t_plc_ns, self.plant.sample("line down" not in self._until))
        watch.cycle(t_plc_ns, valves)
        if self.t_ns % STATE_PERIOD.duration_ns < cycle_ms * MS and self.plc.link.peer is not None:
            datagram = self.plc.send(t_plc_ns)
            if self.plc.link.peer == self._pc_source:
                self.to_pc.push(datagram, self.t_ns)
        self.plant.step(valves, cycle_ms)

    def _cycle_pc(self) -> None:
        arrived = self.to_pc.pop(self.t_ns)
        if self._pc_dead:
            return
        t_pc_ns = self.t_ns + self._pc_epoch_ns
        for datagram in arrived:
            self._note(self.client.receive(datagram, t_pc_ns))
        if self.t_ns % COMMAND_PERIOD.duration_ns >= self.schedule.cycle_ms * MS:
            return
        self.operator.act(self.client, t_pc_ns)
        self._note(self.client.poll(t_pc_ns))
        datagram = self.client.send(t_pc_ns)
        if datagram is not None:
            self.to_plc.push(self._changed(datagram), self.t_ns)

    def _changed(self, datagram: bytes) -> bytes:
        """The command, or another mode in its place while such an act lasts."""
        if self._instead is None or not self.client.linked:
            return datagram
        mode, until_ns = self._instead
        if self.t_ns >= until_ns:
            self._instead = None
            return datagram
        command = decode_command(datagram)
        return encode_command(replace(command, mode=mode, knots=(), interp=0, cmd_flags=0, traj_id=0, knot_first=0))

    def _note(self, events: list[ClientEvent]) -> None:
        for event in events:
            match event:
                case TrajectoryEnded():
                    self.ended.append((self.client.session, event))
                case TailAnswered():
                    self.operator.tail_answered((self.client.session, event.traj_id), event.taken)
                case LinkClosed():
                    self._connect()
                case _:
                    pass

    # --- people and processes ----------------------------------------------------------------------------------------

    def _act(self, action: Action) -> None:
        until_ns = self.t_ns + round(action.value * 1e9)
        match action.act:
            case Act.STOP:
                self.client.request_stop("drill")
            case Act.QUICK_STOP:
                self.client.request_stop("drill", quick=True)
            case Act.HOLD:
                self._instead = (Mode.HOLD, until_ns)
            case Act.DISARM:
                self.client.request_disarm()
            case Act.OVERRIDE:
                self.client.speed_override = action.value
            case Act.ENABLE_LOST:
                self.panel.release_enable()
            case Act.LEVER:
                self.panel.lever_taken, self._until["lever"] = True, until_ns
            case Act.ESTOP:
                self.panel.estop_pressed, self._until["estop"] = True, until_ns
            case Act.PC_RESTART:
                self._pc_dead, self._until["pc dead"] = True, until_ns
            case Act.PLC_RESTART:
                self._until["plc stall"] = until_ns
                self._restart_plc()
            case Act.PC_STALL:
                self._until["pc stall"] = until_ns
            case Act.PLC_STALL:
                self._until["plc stall"] = until_ns
            case Act.LINE_DOWN:
                self._until["line down"] = until_ns
            case Act.INTRUDER | Act.OLD_START:
                self._intrude(action.act)

    def _end_what_is_over(self) -> None:
        over = [name for name, until_ns in self._until.items() if self.t_ns >= until_ns]
        for name in over:
            del self._until[name]
            if name == "lever":
                self.panel.lever_taken = False
            elif name == "estop":
                self.panel.estop_pressed = False
            elif name == "pc dead":
                self._pc_dead = False
                self._pc_source += self._rng.random() < 0.5  # from the same port or from another one
                self._connect()

    def _restart_plc(self) -> None:
        self._close_watch()
        self._start_plc()

    def _intrude(self, act: Act) -> None:
        """A well-formed command from somebody else, or from us for a motion that is over: neither may do anything."""
        session = self.plc.link.session
        hello = ClientLink(self.plc.settings.limit_table, _FRAMING, session or 1).send(0)
        if hello is None:
            return
        command, t_plc_ns = decode_command(hello), self.t_ns + self._plc_epoch_ns
        mine = act is Act.OLD_START
        command = replace(
            command,
            hello=False,
            session=session,
            seq=(self.client.state.ack_seq if self.client.state else 0) + 1,
            mode=Mode.ARM if not mine else Mode.TRAJECTORY,
            arm_nonce=self.plc.link.nonce,
            ack_plc_seq=self.plc.link.state_seq,
            t_plc_echo_ns=t_plc_ns,
            traj_id=max((i for s, i in self.watch.started if s == session), default=1),
            **self._old_knots(session) if mine else {},
        )
        source = self._pc_source if mine else "somebody else"
        self.watch.events(self.plc.receive(encode_command(command), t_plc_ns, source), t_plc_ns)

    def _old_knots(self, session: int) -> dict[str, object]:
        """The beginning of the newest trajectory of the session, with the start flag."""
        knots = next((k for (s, _), k in reversed(self.operator.knots.items()) if s == session), ())[:6]
        return {"knots": knots, "interp": 3 if knots else 0, "cmd_flags": 2}

    # --- the end -----------------------------------------------------------------------------------------------------

    def _fall_silent(self) -> None:
        """The PC is gone for good; levers and keys are left alone from here on."""
        self._pc_dead = True
        self._actions.clear()
        self._until = {name: t for name, t in self._until.items() if name != "pc dead"}
        self.to_plc.lose_pending()  # what was on its way is gone, too: the bounds count from the last one that arrives

    def _close_watch(self) -> None:
        self._faults += self.watch.faults_seen
        self._starts += len(self.watch.started)
        self.underruns += self.plc.underruns
        self._longest.add(self.watch.longest)

    def _judge_ends(self) -> None:
        """The PC's story must be the PLC's: one end for each motion, and "reached" only where the last knot is."""
        told = Counter((session, event.traj_id) for session, event in self.ended)
        for key, times in told.items():
            if times > 1 or key not in self.operator.asked:
                self.breaches.append(Breach("an end told twice or of nothing", 0.0, f"{key}: {times}"))
        for session, event in self.ended:
            key = (session, event.traj_id)
            goal, at = self.operator.goals.get(key), self.ended_at.get(key)
            if event.reached and goal is not None and at is None:
                self.breaches.append(Breach("reached what is not the end", 0.0, f"{key}: the PLC has not been there"))
            elif event.reached and goal is not None and at is not None:
                miss = max(abs(a - b) for a, b in zip(goal, at, strict=False))
                if miss > _ROUNDING_RAD:
                    self.breaches.append(Breach("reached what is not the end", 0.0, f"{key}: {miss:.6f} rad off"))

    def _result(self) -> DrillResult:
        cycle_s = self.schedule.cycle_ms * 1e-3
        return DrillResult(
            seed=self.schedule.seed,
            breaches=self.breaches,
            worst={motion.name: row.round(6).tolist() for motion, row in zip(Motion, self._worst, strict=True)},
            to_plc=self.to_plc.counts,
            to_pc=self.to_pc.counts,
            virtual_s=round(self.t_ns * 1e-9, 3),
            seconds_in={name: round(n * cycle_s, 3) for name, n in sorted(self._cycles_in.items())},
            starts=self._starts,
            reached=sum(event.reached for _, event in self.ended),
            ended_early=sum(not event.reached for _, event in self.ended),
            tails=self.operator.tails,
            servos=self.operator.servos,
            sessions=self.sessions,
            faults=dict(sorted(self._faults.items())),
            underruns=self.underruns,
            longest=self._longest,
        )


def run_schedule(
    schedule: FaultSchedule, machine: Machine | None = None, plant: DrillPlant | None = None
) -> DrillResult:
    """Run a schedule on the ideal stand-in, or on the machine and plant given."""
    machine = drill_machine(schedule.cycle_ms) if machine is None else machine
    plant = IdealPlant(machine, np.deg2rad(_Q_START_DEG)) if plant is None else plant
    return Drill(schedule, machine, plant).run()


def as_json(result: DrillResult) -> dict[str, object]:
    """The result as plain values."""
    return asdict(result)
