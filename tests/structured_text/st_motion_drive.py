"""Seeded motions for a pair: trajectories sent window by window, and everything that can happen to them on the way."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from st_motion_pair import MS, MotionPair

from protocol.codes import CommandFlag, Interp, Mode, RejectCode
from protocol.messages import Command, Knot, pad_to_eight_axes
from protocol.playback import Playback
from sim_plc.plc.reference import Motion

COMMAND_NS = 20 * MS
_MOVING = (Motion.PLAY, Motion.PATH_STOP, Motion.JOINT_STOP, Motion.SERVO)
_OVERRIDES = (1.0, 1.0, 0.7, 0.3, 0.05, 0.0, -0.0)


def _swell(u: float) -> np.ndarray:
    """Quintic step from 0 to 1 and its two derivatives by u."""
    if not 0.0 < u < 1.0:
        return np.array([float(u >= 1.0), 0.0, 0.0])
    return np.array(
        [10 * u**3 - 15 * u**4 + 6 * u**5, 30 * u**2 - 60 * u**3 + 30 * u**4, 60 * u - 180 * u**2 + 120 * u**3]
    )


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Value and two derivatives of a product of two functions of time."""
    return np.array([a[0] * b[0], a[1] * b[0] + a[0] * b[1], a[2] * b[0] + 2 * a[1] * b[1] + a[0] * b[2]])


@dataclass(slots=True)
class Wave:
    """Every joint swings by itself, swelling from rest and back to rest: no two joints brake alike."""

    q0: np.ndarray
    amplitude: np.ndarray
    omega: np.ndarray
    fade_s: float
    duration_s: float

    def at(self, t: float) -> np.ndarray:
        """q, qd, qdd (3, n) at time t [s]."""
        scale = np.array([1.0, 1.0 / self.fade_s, 1.0 / self.fade_s**2])
        rise = _swell(t / self.fade_s) * scale
        fall = _swell((self.duration_s - t) / self.fade_s) * scale * np.array([1.0, -1.0, 1.0])
        s, c, w = np.sin(self.omega * t), np.cos(self.omega * t), self.omega
        swing = np.array([s, w * c, -(w**2) * s])
        window = _product(rise, fall)[:, None] * np.ones(len(w))
        return np.array([self.q0, 0 * self.q0, 0 * self.q0]) + self.amplitude * _product(window, swing)


def wave(pair: MotionPair, rng: np.random.Generator, share: float) -> Wave:
    """A wave from the pair's reference on, with this share of what range, speed and acceleration allow."""
    s, q0, ones = pair.settings, pair.q_ref, np.ones(pair.settings.n)
    fade_s = float(rng.uniform(0.6, 1.5))
    path = Wave(q0, ones, rng.uniform(0.5, 3.0, s.n), fade_s, float(rng.uniform(2.2, 4.0) * fade_s))
    points = np.abs(np.array([path.at(t) - path.at(0.0) for t in np.linspace(0.0, path.duration_s, 60)])).max(axis=0)
    room = np.maximum(np.minimum(q0 - s.q_min, s.q_max - q0) - 0.05, 0.0)
    path.amplitude = (
        share * np.min(np.array([room, s.qd_max, s.qdd_stop]) / points, axis=0) * rng.choice([-1.0, 1.0], s.n)
    )
    return path


def knots_of(pair: MotionPair, path: Wave, spacing_ms: tuple[int, int], rng: np.random.Generator) -> tuple[Knot, ...]:
    """Knots of a wave at irregular times; the last one at rest. Peaks beyond the limits lie between knots only."""
    s, free = pair.settings, np.full(pair.settings.n, np.inf)
    most = np.array([free, s.qd_max, s.qdd_stop])
    times, end = [0], round(path.duration_s * 1e9)
    while times[-1] < end:
        times.append(times[-1] + int(rng.integers(spacing_ms[0] * MS, spacing_ms[1] * MS + 1)))
    zero = pad_to_eight_axes(tuple(np.zeros(len(path.q0)).tolist()))
    knots = [
        Knot(t, *(pad_to_eight_axes(tuple(row.tolist())) for row in np.clip(path.at(t * 1e-9), -most, most)))
        for t in times
    ]
    knots[0], knots[-1] = (replace(knots[i], qd=zero, qdd=zero) for i in (0, -1))
    return tuple(knots)


def with_number(values: tuple[float, ...], j: int, value: float) -> tuple[float, ...]:
    """The values with one of them replaced."""
    return (*values[:j], value, *values[j + 1 :])


def _some(command: Command, rng: np.random.Generator, change: Callable[[Knot], Knot]) -> Command:
    """One of the command's knots changed."""
    if not command.knots:
        return command
    k = int(rng.integers(len(command.knots)))
    return replace(command, knots=(*command.knots[:k], change(command.knots[k]), *command.knots[k + 1 :]))


def _number(command: Command, rng: np.random.Generator, value: Callable[[float], float], axes: int = 6) -> Command:
    """One number of one knot changed."""
    name, j = str(rng.choice(["q", "qd", "qdd"])), int(rng.integers(axes))
    return _some(
        command,
        rng,
        lambda knot: replace(knot, **{name: with_number(getattr(knot, name), j, value(getattr(knot, name)[j]))}),
    )


def spoilt(command: Command, rng: np.random.Generator) -> Command:
    """A command with something wrong, or oddly right, in the part that the motion half looks at."""
    kind = int(rng.integers(13))
    if kind == 0:
        return replace(command, interp=rng.choice([Interp.NONE, Interp.LINEAR, Interp.CUBIC]))
    if kind == 1:
        return replace(command, knot_first=max(command.knot_first + int(rng.choice([-3, -1, 1, 2, 8, 70])), 0))
    if kind == 2:
        return replace(command, knot_first=int(rng.choice([0, 1, 2**31, 2**32 - 1])))
    if kind == 3:
        return replace(command, cmd_flags=CommandFlag(int(rng.integers(8))))
    if kind == 4:
        return replace(command, knots=command.knots[: int(rng.integers(7))])
    if kind == 5:
        return _number(command, rng, lambda x: -x)
    if kind == 6:
        return _number(command, rng, lambda x: x + float(rng.choice([1e-9, 2e-6, 1e-3, 0.02, 0.5, 6.0, 1e300])))
    if kind == 7:
        return _number(command, rng, lambda x: -0.0 if x == 0.0 else np.nextafter(x, 9.0))
    if kind == 8:
        return _number(command, rng, lambda x: float(rng.choice([1e-300, -0.0, 1.0])), axes=8)
    if kind == 9:
        return _some(
            command, rng, lambda knot: replace(knot, t_ns=knot.t_ns + int(rng.choice([1, 3 * MS, 151 * MS, 2**63])))
        )
    if kind == 10:
        return _some(
            command, rng, lambda knot: replace(knot, t_ns=max(knot.t_ns - int(rng.choice([1, 46 * MS, 10**12])), 0))
        )
    if kind == 11:
        return replace(command, cmd_flags=command.cmd_flags ^ CommandFlag.LAST_IS_END)
    return replace(command, traj_id=command.traj_id + 1)


def correction(playback: Playback, first: int, rng: np.random.Generator) -> tuple[Knot, ...]:
    """A tail from `first` on that joins the knot before it, with a smooth step of every joint added over the rest."""
    before, end = playback.knots[first - 1], playback.knots[-1]
    T = (end.t_ns - before.t_ns) * 1e-9
    shift = np.append(rng.normal(size=6) * 2e-3 * T * T, [0.0, 0.0])
    tail = []
    for knot in playback.knots[first:]:
        step = _swell((knot.t_ns - before.t_ns) * 1e-9 / T) / np.array([1.0, T, T * T])
        q, qd, qdd = (np.array(v) + d * shift for v, d in zip((knot.q, knot.qd, knot.qdd), step, strict=True))
        tail.append(Knot(knot.t_ns, *(tuple(v.tolist()) for v in (q, qd, qdd))))
    return tuple(tail)


@dataclass(slots=True)
class Trouble:
    """How often what happens, per command or per cycle."""

    spoil: float = 0.15
    lose: float = 0.2
    withhold: float = 0.01  # a hole of up to a second
    override: float = 0.03
    correct: float = 0.02
    stop_per_s: float = 0.15


class Driver:
    """A PC, the network and an operator at once, all from one seed."""

    def __init__(self, pair: MotionPair, rng: np.random.Generator, trouble: Trouble) -> None:
        self.pair, self.rng, self.trouble = pair, rng, trouble
        self._traj_id, self._override = 0, 1.0
        self._silent_until = 0
        self._uncorrected = Playback(0, ())

    def trajectory(self) -> None:
        """One trajectory from its first window to rest, however it comes there."""
        rng, pair = self.rng, self.pair
        spacing = [(5, 12), (50, 50), (15, 60), (40, 120), (200, 200)][int(rng.integers(5))]
        share = float(rng.uniform(0.3, 1.06)) if spacing[1] < 200 else 0.3
        self._traj_id = max(self._traj_id, pair.ring.traj_id) + 1
        playback = Playback(self._traj_id, knots_of(pair, wave(pair, rng, share), spacing, rng))
        self._override, self._silent_until = float(rng.choice(_OVERRIDES[:4])), 0
        next_ns = pair.t_ns
        for _ in range(round(8e9 / pair.settings.cycle_ns)):
            if pair.t_ns >= next_ns:
                next_ns += COMMAND_NS
                playback = self._command(playback)
            self._operator()
            if pair.cycle() or (pair.motion not in _MOVING and rng.random() < pair.settings.cycle_s):
                return

    def servo(self) -> None:
        """Targets that wander about the reference, to an end or to a stop."""
        rng, pair = self.rng, self.pair
        self._traj_id = max(self._traj_id, pair.ring.traj_id) + 1
        middle, self._override = pair.q_ref, float(rng.choice(_OVERRIDES[:4]))
        reach = 0.25 * pair.settings.qd_max * float(rng.choice([0.1, 0.3, 0.6]))
        count = int(rng.integers(20, 150))
        for i in range(count + 50):  # the last target stands for a second
            if i <= count and (rng.random() >= 0.1 or i == count):
                self._servo_command(middle, reach, ending=i == count)
            for _ in range(max(COMMAND_NS // pair.settings.cycle_ns, 1)):
                self._operator()
                if pair.cycle():
                    return

    def finish(self) -> None:
        """Down to rest."""
        if self.pair.motion in _MOVING:
            self.pair.stop("Stop")
        while self.pair.motion in _MOVING:
            self.pair.cycle()

    def _servo_command(self, middle: np.ndarray, reach: np.ndarray, ending: bool) -> None:
        rng, s = self.rng, self.pair.settings
        near = self.pair.q_ref if rng.random() < 0.5 else middle
        q = np.clip(near + reach * rng.normal(size=6), s.q_min, s.q_max)
        qd = s.qd_max * rng.uniform(-1.0, 1.0, 6) * (rng.random(6) < 0.6)
        if rng.random() < 0.05:
            q, qd = (s.q_min if rng.random() < 0.5 else s.q_max), qd * 1.2
        flags = CommandFlag.START | (CommandFlag.LAST_IS_END if ending else CommandFlag(0))
        knot = Knot(
            0, pad_to_eight_axes(tuple(q.tolist())), pad_to_eight_axes(tuple((0.0 * qd if ending else qd).tolist()))
        )
        command = replace(self._base(Mode.SERVO), interp=Interp.LINEAR, cmd_flags=flags, knots=(knot,))
        if rng.random() < self.trouble.spoil:
            self.pair.deliver(spoilt(command, rng))
        self.pair.deliver(command)

    def _base(self, mode: Mode) -> Command:
        return Command(1, 1, 0, mode=mode, traj_id=self._traj_id, speed_override=self._override)

    def _command(self, playback: Playback) -> Playback:
        """What one command period brings."""
        rng, trouble, pair = self.rng, self.trouble, self.pair
        if rng.random() < trouble.withhold:
            self._silent_until = pair.t_ns + int(rng.integers(100, 1500)) * MS
        if rng.random() < trouble.override:
            self._override = float(rng.choice(_OVERRIDES)) if rng.random() < 0.7 else float(rng.random())
        if rng.random() < trouble.correct and playback.splice_knot_index is None:
            playback = self._corrected(playback)
        window = playback.window(pair.state())
        base = self._base(Mode.TRAJECTORY)
        command = replace(
            base,
            interp=Interp.QUINTIC,
            knot_first=window.knot_first,
            knots=window.knots,
            cmd_flags=window.command_flags,
        )
        if rng.random() < trouble.spoil:
            pair.deliver(spoilt(command, rng))
        if pair.t_ns < self._silent_until or rng.random() < trouble.lose:
            return playback
        return self._answered(
            playback,
            pair.deliver(command),
            playback.splice_knot_index is not None and window.holds_knot(playback.splice_knot_index),
        )

    def _answered(self, playback: Playback, code: RejectCode, covered: bool) -> Playback:
        """What the PC does about a correction that was taken, or refused."""
        if playback.splice_knot_index is None or not covered:
            return playback
        self.pair.seen.events[f"correction: {code.name}"] += 1
        return playback.with_splice_accepted() if code is RejectCode.NONE else self._uncorrected

    def _corrected(self, playback: Playback) -> Playback:
        """Another tail, from somewhere that may be frozen already."""
        playing = self.pair.reference.knot_playing
        first = playing + int(self.rng.integers(1, 15))
        if not 1 <= first < playback.last:
            return playback
        self._uncorrected = playback
        return playback.with_tail(first, correction(playback, first, self.rng))

    def _operator(self) -> None:
        rng = self.rng
        if rng.random() < self.trouble.stop_per_s * self.pair.settings.cycle_s:
            self.pair.stop(str(rng.choice(["Stop", "Stop", "QuickStop", "StopAlongPath"])))


def drive(pair: MotionPair, seed: int, motions: int, trouble: Trouble) -> None:
    """A seeded run of so many motions, one in four in servo mode, now and then in a new session."""
    driver = Driver(pair, np.random.default_rng(seed), trouble)
    for _ in range(motions):
        if driver.rng.random() < 0.25:
            driver.servo()
        else:
            driver.trajectory()
        driver.finish()
        if driver.rng.random() < 0.1:
            pair.new_session()
            pair.hold(pair.q_ref + 1e-3, follow=True)
            pair.hold(pair.q_ref)
