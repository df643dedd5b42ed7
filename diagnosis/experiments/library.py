"""Experiments that a machine can do within its limits: motions of the reference, postures to look or measure from."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from diagnosis.log.nominal import Nominal
from machine.rotations import Array
from recording.run import SegmentKind

SAMPLE_PERIOD_S = 0.01
MOTION_DURATION_S = 45.0
LOAD_HOLD_DURATION_S = 60.0
TRAVEL_DURATION_MIN_S = 12.0  # to a posture, and back
SPEED_LIMIT_FRAC = 0.55  # of the velocity gain: commands stay below 55 %, and below the joints' speed limits
ACCELERATION_SPEED_RATIO_PER_S = 1.0  # acceleration over velocity gain [1/s]
AMPLITUDE_RANGE_FRAC = 0.15  # of the joint's range, at most this much to either side
AMPLITUDE_MAX_RAD = 0.3  # and never more
JOINT_LIMIT_MARGIN_RAD = 0.05
FADE_DURATION_S = 3.0  # in and out
SMOOTHING_EXCESS_RATIO_MIN = 10.0  # times over the limits: a course with corners, which scaling would make nothing of
WIDTH_MIN_S, WIDTH_MAX_S = 0.2, 6.0
DEFAULT_SPEED_RAD_S = 0.3  # rad/s where the file gives no velocity gain
LOOK_CYCLE_DURATION_S = 12.0  # to drive to a posture, come to rest and look


@dataclass(frozen=True, slots=True)
class Motion:
    """A reference over time: q (m, n) [rad] every SAMPLE_PERIOD_S; begins and ends at rest in its first posture."""

    name: str
    segment_kind: SegmentKind
    q: Array

    @property
    def duration_min(self) -> float:
        """Machine time."""
        return len(self.q) * SAMPLE_PERIOD_S / 60.0


@dataclass(frozen=True, slots=True)
class Postures:
    """Encoder readings (k, n) [rad] to come to rest in, each from below, and to look (or measure points) from."""

    name: str
    q: Array

    @property
    def duration_min(self) -> float:
        """Machine time."""
        return len(self.q) * LOOK_CYCLE_DURATION_S / 60.0


Experiment = Motion | Postures
Shape = Callable[[Array, int], Array]  # t (m,), joint (0-based) -> (m,), within -1..1


def library_motions(
    nominal: Nominal, centre: Array, joints: tuple[int, ...], loaded: tuple[Array, Array] | None
) -> tuple[Motion, ...]:
    """The library's motions of some joints (0-based) around a posture (n,) [rad].

    Args: loaded: postures (n,) of high and of low load on these joints; None where loads are not known.
    """
    t = np.asarray(np.arange(round(MOTION_DURATION_S / SAMPLE_PERIOD_S)) * SAMPLE_PERIOD_S, dtype=float)
    centre = np.clip(centre, *posture_bounds(nominal))  # it may have been recorded beyond the file's range
    everyone = tuple(range(nominal.n))

    def around(name: str, kind: SegmentKind, shape: Shape, moving: tuple[int, ...] = joints) -> Motion:
        return Motion(name, kind, _reference_within_limits(nominal, centre, moving, shape, t))

    found = [
        around("multisine", "multisine", _multisine),
        *(around(f"{word}steps", "steps", _step_sequence_shape(size)) for word, size in LABELLED_STEP_SIZES),
        around("jogs there and back", "workcycle", _constant_speed_jogs),
        around("slow reversals through zero", "sweep", lambda t, j: 0.3 * np.sin((0.25 + 0.03 * j) * t)),
        around("staircase around zero", "staircase", _growing_steps),
    ]
    if len(joints) < nominal.n:
        found.append(around("all joints together", "multisine", _multisine, everyone))
    if loaded is not None:
        found += _under_load(nominal, centre, joints, loaded)
    return tuple(found)


LABELLED_STEP_SIZES = (("small ", 0.06), ("", 0.35), ("large ", 1.0))


def _under_load(
    nominal: Nominal, centre: Array, joints: tuple[int, ...], loaded: tuple[Array, Array]
) -> tuple[Motion, ...]:
    """The same motion where the load is high and where it is low, and a minute of rest under load."""
    t = np.asarray(np.arange(round(0.5 * MOTION_DURATION_S / SAMPLE_PERIOD_S)) * SAMPLE_PERIOD_S, dtype=float)
    legs = []
    here = centre
    for posture in loaded:
        there = _reference_within_limits(
            nominal, _posture_away_from_limits(nominal, posture, joints), joints, _constant_speed_jogs, t
        )
        legs += [_quintic_travel(nominal, here, there[0]), there]
        here = there[-1]
    legs.append(_quintic_travel(nominal, here, centre))
    still = np.tile(loaded[0], (round(LOAD_HOLD_DURATION_S / SAMPLE_PERIOD_S), 1))
    hold = [_quintic_travel(nominal, centre, loaded[0]), still, _quintic_travel(nominal, loaded[0], centre)]
    return (
        Motion("the same motion at high and at low load", "workcycle", np.concatenate(legs)),
        Motion("hold under load", "hold", np.concatenate(hold)),
    )


def speed_limits(nominal: Nominal) -> Array:
    """Speeds (n,) [rad/s] that no motion of the library exceeds."""
    if nominal.actuators is None:
        return np.full(nominal.n, SPEED_LIMIT_FRAC * DEFAULT_SPEED_RAD_S)
    return SPEED_LIMIT_FRAC * nominal.actuators.joints[:, 0]


def _reference_within_limits(nominal: Nominal, centre: Array, joints: tuple[int, ...], shape: Shape, t: Array) -> Array:
    """Reference (m, n): each joint's shape scaled into its range, speed and acceleration."""
    low, high = posture_bounds(nominal)
    q = np.tile(np.clip(centre, low, high), (len(t), 1))
    u = np.clip(np.minimum(t, t[-1] - t) / FADE_DURATION_S, 0.0, 1.0)
    fade = 10 * u**3 - 15 * u**4 + 6 * u**5
    for j in joints:
        course = _limit_speed_acceleration(_motion_amplitude(nominal, j) * fade * shape(t, j), speed_limits(nominal)[j])
        up, down = high[j] - q[0, j], q[0, j] - low[j]
        share = min(1.0, up / max(float(course.max()), 1e-9), down / max(float(-course.min()), 1e-9))
        q[:, j] += share * course  # scaled, not clipped: no machine can follow a corner at the range's end
    return q


def _motion_amplitude(nominal: Nominal, j: int) -> float:
    """How far a joint (0-based) is moved to either side at most."""
    span = float(nominal.q_max[j] - nominal.q_min[j])
    return min(AMPLITUDE_RANGE_FRAC * span, AMPLITUDE_MAX_RAD) if np.isfinite(span) else AMPLITUDE_MAX_RAD


def _posture_away_from_limits(nominal: Nominal, posture: Array, joints: tuple[int, ...]) -> Array:
    """A posture (n,) moved in from the ends of the ranges, so that these joints have room to either side."""
    low, high = posture_bounds(nominal)
    out = np.clip(posture, low, high)
    for j in joints:
        size = min(_motion_amplitude(nominal, j), 0.5 * float(high[j] - low[j]))
        out[j] = np.clip(out[j], low[j] + size, high[j] - size)
    return out


def posture_bounds(nominal: Nominal) -> tuple[Array, Array]:
    """Where joints may be sent (n,), low and high: off the ends of their ranges; one place where that leaves none."""
    high = np.maximum(nominal.q_min, nominal.q_max - JOINT_LIMIT_MARGIN_RAD)
    return np.minimum(nominal.q_min + JOINT_LIMIT_MARGIN_RAD, high), high


def _limit_speed_acceleration(x: Array, speed: float) -> Array:
    """A course from 0 to 0 within a speed and ACCELERATION_SPEED_RATIO_PER_S / SPEED_LIMIT_FRAC times as much
    acceleration.

    Model: what is smooth already is scaled; what has corners is averaged (Hann) over as little as the limits ask for.
    """
    acceleration = speed * ACCELERATION_SPEED_RATIO_PER_S / SPEED_LIMIT_FRAC
    y, width_s = x, WIDTH_MIN_S
    if _limit_excess_ratio(x, speed, acceleration) > SMOOTHING_EXCESS_RATIO_MIN:
        while True:
            y = _hann_smoothed(x, round(0.5 * width_s / SAMPLE_PERIOD_S))
            if _limit_excess_ratio(y, speed, acceleration) <= 1.0 or width_s > WIDTH_MAX_S:
                break
            width_s *= 1.25
    return y / max(1.0, _limit_excess_ratio(y, speed, acceleration))


def _limit_excess_ratio(x: Array, speed: float, acceleration: float) -> float:
    """How many times over its limits a course (m,) is."""
    v = np.diff(x) / SAMPLE_PERIOD_S
    a = np.diff(v) / SAMPLE_PERIOD_S
    return max(float(np.abs(v).max(initial=0.0)) / speed, float(np.abs(a).max(initial=0.0)) / acceleration)


def _hann_smoothed(x: Array, half: int) -> Array:
    """A course averaged over 2 half + 1 samples, at rest at 0 at both ends."""
    held = x.copy()
    held[: half + 1] = held[-half - 1 :] = 0.0
    window = np.hanning(2 * half + 1)
    return np.asarray(np.convolve(np.pad(held, half), window / window.sum(), mode="valid"), dtype=float)


def _quintic_travel(nominal: Nominal, start: Array, end: Array) -> Array:
    """From rest to rest by a quintic, no faster than the limits."""
    slowest = float((1.9 * np.abs(end - start) / speed_limits(nominal)).max())
    rows = round(max(TRAVEL_DURATION_MIN_S, slowest) / SAMPLE_PERIOD_S)
    u = np.linspace(0.0, 1.0, rows)[:, None]
    return start + (10 * u**3 - 15 * u**4 + 6 * u**5) * (end - start)


def _multisine(t: Array, j: int) -> Array:
    w = 0.7 + 0.13 * j
    return 0.5 * np.sin(w * t) + 0.3 * np.sin(2.3 * w * t + 1.0) + 0.2 * np.sin(5.1 * w * t + 2.0)


def _step_sequence_shape(size: float) -> Shape:
    def shape(t: Array, j: int) -> Array:
        w = 0.8 + 0.11 * j
        return size * np.sign(np.sin(w * t)) * (0.3 + 0.7 * np.abs(np.sin(0.29 * w * t)))

    return shape


def _constant_speed_jogs(t: Array, j: int) -> Array:
    """Constant speed up and down, at four speeds."""
    period = 11.0 + 0.7 * j
    return (2.0 / np.pi) * np.arcsin(np.sin(2.0 * np.pi * t / period)) * (1.0 - 0.2 * np.floor(t / period) % 0.8)


def _growing_steps(t: Array, j: int) -> Array:
    """Steps of growing size to both sides: commands around the middle of the valve."""
    number = np.floor(t / (2.5 + 0.1 * j))
    return np.where(number % 2 == 0, 1.0, -1.0) * 0.012 * (1.0 + number % 8)
