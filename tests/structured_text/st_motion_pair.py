"""FB_HmMotion and the simulated PLC's reference side by side: same commands, same cycles, the same bits."""

import struct
from collections import Counter
from dataclasses import dataclass, field, replace
from importlib.resources import files
from typing import Protocol

import numpy as np

from machine.description import parse_machine_toml
from protocol.codec import decode_command, encode_command
from protocol.codes import CommandFlag, Interp, Mode, PlcState, RejectCode
from protocol.messages import Command, State, pad_to_eight_axes
from protocol.objection import Objection, object_to
from sim_plc.plc.knot_ring import KnotRing, PlaybackView
from sim_plc.plc.reference import Motion, Reference
from sim_plc.plc.servo import check_target
from sim_plc.plc.settings import PlcSettings, plc_settings

MS = 1_000_000
MOTIONS = (Motion.FOLLOW, Motion.HOLD, Motion.PLAY, Motion.PATH_STOP, Motion.JOINT_STOP, Motion.SERVO)
Q_START = np.deg2rad([10.0, 40.0, -80.0, 5.0, -40.0, 3.0])
Outputs = dict[str, int | float | tuple[float, ...]]


def settings_of(cycle_s: float) -> PlcSettings:
    """The crane's settings with another PLC cycle."""
    text = (files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8")
    return plc_settings(replace(parse_machine_toml(text), plc_cycle_s=cycle_s))


class StMotion(Protocol):
    """What the pair needs of FB_HmMotion, wherever it runs."""

    def check(self, payload: bytes, servo: bool) -> tuple[int, int]:
        """Reject code and offset of CheckServo or CheckTrajectory."""
        ...

    def load(self, payload: bytes) -> None:
        """Load."""
        ...

    def load_servo(self, payload: bytes, t_ns: int) -> None:
        """LoadServo."""
        ...

    def stay(self, method: str, q: tuple[float, ...]) -> None:
        """HoldAt or Follow, at 8 values."""
        ...

    def do(self, method: str) -> None:
        """A method without arguments."""
        ...

    def starving(self) -> bool:
        """Starving."""
        ...

    def step(self, t_ns: int) -> bool:
        """Step."""
        ...

    def outputs(self) -> Outputs:
        """Publish, then every output by its name; eMotion as a number, joint arrays with 8 values."""
        ...


def bits(value: object) -> object:
    """Something that is equal only for equal bits: -0.0 is not 0.0 here."""
    if isinstance(value, float):
        return struct.pack("<d", value)
    return tuple(bits(v) for v in value) if isinstance(value, tuple) else value


@dataclass(slots=True)
class Seen:
    """What a run has met, so that a test can tell that it was worth something."""

    cycles: int = 0
    rejects: Counter[str] = field(default_factory=Counter)
    motions: Counter[str] = field(default_factory=Counter)
    events: Counter[str] = field(default_factory=Counter)


class MotionPair:
    """Both references, driven as the PLC's logic drives them. Raises AssertionError at the first bit that differs."""

    def __init__(self, st: StMotion, settings: PlcSettings) -> None:
        self.st, self.settings, self.seen = st, settings, Seen()
        self.ring = KnotRing(settings.limit_table)
        self.reference = Reference(settings, self.ring)
        self.t_ns = 1000 * MS
        self._spent = False
        self.hold(Q_START)

    @property
    def motion(self) -> Motion:
        """What the reference does."""
        return self.reference.motion

    @property
    def q_ref(self) -> np.ndarray:
        """A copy of the reference's position (n,)."""
        return self.reference.q.copy()

    def hold(self, q: np.ndarray, follow: bool = False) -> None:
        """Both stay at q (n,)."""
        (self.reference.follow_joints if follow else self.reference.hold_at)(q)
        self.st.stay("Follow" if follow else "HoldAt", pad_to_eight_axes(tuple(q.tolist())))
        self.compare("hold")

    def new_session(self) -> None:
        """What the logic does when a session opens."""
        self.reference.leave_path()
        if self.st.outputs()["eMotion"] == MOTIONS.index(Motion.PATH_STOP):
            self.st.do("StopStraight")  # so FB_HmPlc does it
        self.ring.clear()
        self.reference.rewind()
        self.st.do("ClearRing")
        self.st.do("Rewind")
        self.compare("new session")

    def state(self) -> State:
        """As much of the state datagram as the PC's playback looks at."""
        reference, last = self.reference, max(self.ring.last, 0)
        numbers = {"traj_id": self.ring.traj_id, "knot_playing": reference.knot_playing, "knot_last": last}
        return State(1, 1, self.t_ns, PlcState.RUN, t_play_ns=reference.t_play_ns, **numbers)

    def deliver(self, command: Command) -> RejectCode:
        """Check a motion command on both, and take it on both if it may be taken."""
        payload = encode_command(command)
        command = decode_command(payload)
        servo = command.mode is Mode.SERVO
        mine = self._check(command)
        code = mine.code if mine else RejectCode.NONE
        assert self.st.check(payload, servo) == (code, mine.field_offset if mine else 0), command
        self.seen.rejects[code.name] += 1
        if mine is None and self._is_wanted(command):
            self._take(command, payload, servo)
        self.compare("after a command")
        return code

    def cycle(self, watch: bool = True) -> bool:
        """One cycle of both; whether a motion ended. `watch`: knots that run out stop it in time, as in the logic."""
        self.t_ns += self.settings.cycle_ns
        self.seen.cycles += 1
        self.seen.motions[self.motion.name] += 1
        starving = self.reference.starving()
        assert self.st.starving() == starving, f"t = {self.t_ns} ns: python {starving}"
        if starving and watch:
            self.seen.events["starved"] += 1
            self.stop("StopAlongPath")
        ramping = self.motion in (Motion.PATH_STOP, Motion.JOINT_STOP)
        over = self.reference.step(self.t_ns)
        rests = self.st.step(self.t_ns)
        faded = not ramping or self.reference.fade == 0.0  # FB_HmPlc's part of it
        assert (rests and faded) == over, f"t = {self.t_ns} ns, {self.motion.name}: python {over}"
        self.compare("after a step")
        if over:
            self.seen.events[f"end of {self.motion.name}"] += 1
            self._settle(not ramping)
        return over

    def stop(self, method: str) -> None:
        """Stop, QuickStop or StopAlongPath."""
        reference = self.reference
        before = self.motion
        {"Stop": reference.stop, "QuickStop": reference.quick_stop, "StopAlongPath": reference.stop_along_path}[
            method
        ]()
        self.st.do(method)
        self.seen.events[f"{method}: {before.name} to {self.motion.name}"] += 1
        self._spent = True
        self.compare(method)

    def compare(self, where: str) -> None:
        """Hold every output of the ST against Python's."""
        ours, theirs = self._outputs(), self.st.outputs()
        for name, value in ours.items():
            assert bits(theirs[name]) == bits(value), f"{where}, t = {self.t_ns} ns: {name} {theirs[name]} != {value}"

    def _outputs(self) -> Outputs:
        reference, ring = self.reference, self.ring
        override = self.motion in (Motion.HOLD, Motion.SERVO)
        return {
            "eMotion": MOTIONS.index(self.motion),
            "aQRef": pad_to_eight_axes(tuple(reference.q.tolist())),
            "aQdRef": pad_to_eight_axes(tuple(reference.qd.tolist())),
            "aQddRef": pad_to_eight_axes(tuple(reference.qdd.tolist())),
            "nTrajId": ring.traj_id,
            "nKnotPlaying": reference.knot_playing,
            "nKnotLast": max(ring.last, 0),
            "nBufferUs": round(reference.buffer_s * 1e6),
            "nPlayNs": reference.t_play_ns,
            "fRate": float(reference.rate),
            "fSpeedScale": float(reference.speed_override if override else reference.rate),
        }

    def _view(self) -> PlaybackView:
        reference = self.reference
        return PlaybackView(pad_to_eight_axes(tuple(reference.q.tolist())), reference.knot_playing, reference.t_play_ns)

    def _check(self, command: Command) -> Objection | None:
        if command.mode is Mode.SERVO:
            return check_target(command, self._view().q_ref, self.settings)
        if command.interp is not Interp.QUINTIC:
            return object_to(RejectCode.INTERP, "interp")
        return self.ring.check(command, self._view())

    def _is_wanted(self, command: Command) -> bool:
        """What the link lets through to the ring: nothing for a motion that is over, or beside the running one."""
        if command.traj_id == self.ring.traj_id:
            return not self._spent
        return self.motion is Motion.HOLD and command.traj_id > self.ring.traj_id

    def _take(self, command: Command, payload: bytes, servo: bool) -> None:
        reference, fresh = self.reference, command.traj_id != self.ring.traj_id
        if fresh and servo:
            self.ring.clear()
            self.ring.traj_id = command.traj_id
            self.st.do("ClearRing")
        if fresh:
            reference.rewind()
            self.st.do("Rewind")
            self._spent = False
        if servo:
            reference.servo.load_target(command, self.t_ns)
            self.st.load_servo(payload, self.t_ns)
        else:
            self.ring.load_knots(command, self._view())
            self.st.load(payload)
        reference.speed_override = command.speed_override
        if self.motion is Motion.HOLD and CommandFlag.START in command.cmd_flags:
            (reference.start_servo if servo else reference.play_from_start)()
            self.st.do("StartServo" if servo else "Play")

    def _settle(self, played: bool) -> None:
        """At the last knot or target, or after a ramp where the joints have come to rest, a little behind."""
        q = self.q_ref - 1e-4
        self.st.do("Settle")
        if played:
            self.reference.settle()
        else:
            self.reference.settle_at(q)
            self.st.stay("HoldAt", pad_to_eight_axes(tuple(q.tolist())))
        self._spent = True
        self.compare("settled")
