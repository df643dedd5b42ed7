"""The six pairs: a machine with one effect of the pair, recorded so that the other one explains it as well."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.diagnosis.experiments import arm
from benchmarks.diagnosis.experiments.arm import BOOM_ARM, CRANE_ARM, TELESCOPE_ARM, Truth
from benchmarks.diagnosis.experiments.recorded import SAMPLE_S, Rig, Run, of_points, of_runs, of_tour
from machine.rotations import Array
from recording.content import Recording

Generator = np.random.Generator
Key = tuple[str, int | None]
WIND = 2e-5
PITCH_AXIS = (0.0, 1.0, 0.0)


@dataclass(frozen=True)
class Case:
    """One draw: the machine as it is rigged, and its ambiguous first recording."""

    rig: Rig
    first: Recording


def draw(pair: str, seed: int) -> Case:
    """One draw of a pair; even seeds have its first effect, odd ones its second.

    Raises: KeyError: no such pair.
    """
    rng = np.random.default_rng([seed, list(PAIRS).index(pair)])
    return PAIRS[pair](seed % 2, rng)


def _one_way(names: tuple[tuple[str, float, float], tuple[str, float, float]], joint: int, wind: float = WIND):
    """Lifts only: motion one way from rest, in one posture."""

    def drawn(which: int, rng: Generator) -> Case:
        name, low, high = names[which]
        truth = Truth(name, joint, float(rng.uniform(low, high)))
        rig = Rig(BOOM_ARM, truth, np.eye(4), wind)
        home = np.array([rng.uniform(-0.5, 0.5), rng.uniform(0.0, 0.5)])
        lift = _lift(home, joint, 0.02, 6.0)
        runs = [Run("repeat", lift, True) for _ in range(4)]
        runs += [Run("workcycle", _lift(home, joint, 0.012, 8.0)), Run("sweep", _lift(home, joint, 0.03, 5.0))]
        return Case(rig, of_runs(rig, runs, rng))

    return drawn


def _lift(home: Array, joint: int, speed: float, seconds: float) -> Array:
    """One joint up at a nearly constant speed after a second of rest, the others at 0.7 of it."""
    t = np.arange(0.0, seconds + 1.0, SAMPLE_S)
    u = np.clip(t - 1.0, 0.0, None)
    share = np.full(len(home), 0.7)
    share[joint - 1] = 1.0
    return home + (speed * np.where(u < 1.0, 0.5 * u**2, u - 0.5))[:, None] * share


def _late(which: int, rng: Generator) -> Case:
    """Slow sweeps of the boom alone, with neither the received reference nor the valve command in the log.

    Why alone: a delay of the link is every joint's, and a second one that moved would tell it from a valve's lag.
    """
    drawn = Truth("valve_lag", 2, float(rng.uniform(0.03, 0.08))) if which == 0 else Truth(
        "transport_delay", None, float(rng.uniform(0.02, 0.04))
    )  # fmt: skip
    rig = Rig(BOOM_ARM, drawn, np.eye(4), 10 * WIND, logged=())
    home = np.array([rng.uniform(-0.5, 0.5), rng.uniform(0.0, 0.5)])
    runs = [Run("repeat", _slow(home, 0.5, 10.0), True) for _ in range(4)]
    runs += [Run("workcycle", _slow(home, 0.35, 12.0)), Run("sweep", _slow(home, 0.7, 10.0))]
    return Case(rig, of_runs(rig, runs, rng))


def _slow(home: Array, w: float, seconds: float) -> Array:
    t = np.arange(0.0, seconds, SAMPLE_S)
    fade = np.clip(np.minimum(t, t[-1] - t) / 2.0, 0.0, 1.0)
    return home + 0.05 * (fade * np.sin(w * t))[:, None] * np.array([0.0, 1.0])


def _bent(which: int, rng: Generator) -> Case:
    """The tip measured in postures near each other.

    Why a crane with a jib: with one boom, gravity's torque is a cosine of its angle, and no posture tells what yields
    to it from a wave of the encoder.
    """
    size = float(rng.uniform(2e-6, 6e-6)), float(rng.uniform(4e-3, 12e-3) * rng.choice([-1.0, 1.0]))
    truth = Truth(("gravity_sag", "encoder_bias")[which], 2, size[which])
    rig = Rig(CRANE_ARM, truth, np.eye(4), point_m=3e-4)
    home = np.array([rng.uniform(-0.5, 0.5), rng.uniform(0.2, 0.6), rng.uniform(-1.2, -0.6)])
    postures = home + rng.uniform(-0.03, 0.03, (16, 3)) * np.array([8.0, 1.0, 1.0])
    return Case(rig, of_points(rig, postures, 6, rng))


def _looking(truth: Truth, rng: Generator, eyes: int) -> tuple[Rig, Array]:
    """A marker straight ahead of the arm's camera, about 1.8 m from the middle of the telescope."""
    home = np.array([rng.uniform(-0.4, 0.4), rng.uniform(0.0, 0.3), 0.4, 0.0, 0.0])
    mount = np.eye(4)
    mount[:3, 3] = arm.P_TCP_CAM
    ahead = np.diag([1.0, -1.0, -1.0, 1.0])
    ahead[2, 3] = rng.uniform(1.6, 2.0)
    T_base_marker = arm.frames(TELESCOPE_ARM, home)[-1] @ mount @ ahead
    return Rig(TELESCOPE_ARM, truth, T_base_marker, eyes=eyes, corner_px=0.1), home


def _straight(which: int, rng: Generator) -> Case:
    """One eye, straight towards the marker and back: only the product of print and focal length shows."""
    name = ("marker_size_error", "focal_length_error")[which]
    size = float(rng.uniform(0.004, 0.015) * rng.choice([-1.0, 1.0]))
    rig, home = _looking(Truth(name, None, size), rng, 1)
    way = np.concatenate([np.linspace(0.05, 0.75, 8), np.linspace(0.7, 0.1, 6)])
    postures = np.tile(home, (len(way), 1))
    postures[:, 2] = way
    return Case(rig, of_tour(rig, postures, rng))


def _held_wrist(which: int, rng: Generator) -> Case:
    """Both eyes, telescope, slew and boom moved, the wrist held."""
    size = float(rng.uniform(4e-3, 12e-3) * rng.choice([-1.0, 1.0]))
    truth = Truth("encoder_bias", 4, size) if which == 0 else Truth("hand_eye_rotation", None, size, PITCH_AXIS)
    rig, home = _looking(truth, rng, 2)
    postures = np.tile(home, (14, 1))
    postures[:, 2] = np.linspace(0.05, 0.75, 14)
    postures[:, :2] += rng.uniform(-0.04, 0.04, (14, 2))
    return Case(replace(rig), of_tour(rig, postures, rng))


PAIRS: dict[str, Callable[[int, Generator], Case]] = {
    "gain-droop": _one_way((("flow_gain_error", -0.25, -0.06), ("load_droop", 0.06, 0.25)), 2),
    "lag-delay": _late,
    "deadband-hysteresis": _one_way((("valve_deadband", 0.01, 0.04), ("valve_hysteresis", 0.01, 0.04)), 1, 2 * WIND),
    "sag-bias": _bent,
    "print-focal": _straight,
    "bias-mount": _held_wrist,
}

#: The two names of each pair, with their joints: the first is the true one of even seeds.
NAMES: dict[str, tuple[Key, Key]] = {
    "gain-droop": (("flow_gain_error", 2), ("load_droop", 2)),
    "lag-delay": (("valve_lag", 2), ("transport_delay", None)),
    "deadband-hysteresis": (("valve_deadband", 1), ("valve_hysteresis", 1)),
    "sag-bias": (("gravity_sag", 2), ("encoder_bias", 2)),
    "print-focal": (("marker_size_error", None), ("focal_length_error", None)),
    "bias-mount": (("encoder_bias", 4), ("hand_eye_rotation", None)),
}
