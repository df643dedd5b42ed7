"""Families of functions of what drives an actuator and of its own modelled course.

Never of what was measured at their end: that holds the very noise which the residual is made of.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from diagnosis.log.tables import fill_gaps
from diagnosis.noise.floor import Whitener, block_increments
from diagnosis.replay.stage_replay import (
    DYNAMIC_STAGE_BY_NAME,
    STAGE_OUTPUT_SIGNALS,
    START_SKIPPED_INCREMENTS,
    Replay,
    StretchReplay,
    whiten_sets,
)
from diagnosis.search.cell import Cell
from machine.effects.dynamics import simulate
from machine.effects.layout import ParameterSets
from machine.rotations import Array

ANGLE_FOURIER_ORDERS = 4  # of waves over the angle, a turn
SMOOTHING_WINDOW_S = 0.045


@dataclass(frozen=True, slots=True)
class Course:
    """Signals of one joint through a stretch, a row a log row (m,), and the time between two rows [s].

    `modelled_output`: the stage's own; `input_signal`: what it answers to; `other_joint_commands`: (m, k); `t_s`: from
    the stretch's start; `since_s`: from the recording's.
    """

    dt_s: float
    t_s: Array
    modelled_output: Array
    input_signal: Array
    gravity_load: Array
    other_joint_commands: Array
    since_s: Array

    def rate(self, x: Array) -> Array:
        """d/dt of a signal."""
        return np.asarray(np.gradient(x, self.dt_s))

    def integral_of(self, x: Array) -> Array:
        """The integral over time of signals (m, k)."""
        return np.asarray(np.cumsum(x, axis=0) * self.dt_s)

    def leaky_integral(self, x: Array, tau_s: float) -> Array:
        """Signals (m, k) integrated, with what was gathered leaking away: what has to be caught up with afterwards."""
        return np.asarray(_leaky_sum(self.dt_s * x, np.exp(-self.dt_s / tau_s)))

    def smoothed(self, x: Array) -> Array:
        """The mean over 45 ms."""
        n = min(max(1, round(SMOOTHING_WINDOW_S / self.dt_s)), len(x))
        return np.convolve(x, np.ones(n) / n, mode="same")


@njit(cache=True)
def _leaky_sum(x: Array, kept: float) -> Array:
    out = x.copy()
    for i in range(1, len(x)):
        out[i] += kept * out[i - 1]
    return out


def courses_of(cell: Cell, replay: Replay, modelled: list[Array], channel: int) -> list[Course]:
    """One joint of a replay through each stretch. `modelled`: by `modelled_of`."""
    return [
        _course_of_stretch(cell, replay, *piece, channel)
        for piece in zip(replay.stretch_replays, modelled, strict=True)
    ]


def modelled_of(cell: Cell, replay: Replay) -> list[Array]:
    """The stage's own output through each stretch (m, joints)."""
    chosen = ParameterSets(
        np.ascontiguousarray(cell.baseline_parameters.joint_parameters[:, list(replay.joints)]),
        cell.baseline_parameters.machine_parameters,
    )
    runs = (
        simulate(part.plant, chosen, part.stage_input, DYNAMIC_STAGE_BY_NAME[cell.stage])
        for part in replay.stretch_replays
    )
    return [np.asarray(getattr(run, STAGE_OUTPUT_SIGNALS[cell.stage])[0]) for run in runs]


def _course_of_stretch(cell: Cell, replay: Replay, part: StretchReplay, outputs: Array, channel: int) -> Course:
    stretch, j, modelled = part.stretch, replay.joints[channel], outputs[:, channel]
    m = len(modelled)
    u = fill_gaps(stretch.u)[:m] if stretch.u is not None else np.zeros((m, j + 1))
    drive = u[:, j]
    if cell.stage == "controller" and stretch.ref is not None and stretch.enc is not None:
        drive = (fill_gaps(stretch.ref) - fill_gaps(stretch.enc))[:m, j]
    if cell.stage == "link":
        drive = np.gradient(modelled, stretch.dt_s)
    load = part.stage_input.load[:m, channel] if len(part.stage_input.load) >= m else np.zeros(m)
    t_s, began_s = stretch.t_s[:m], min(other.stretch.t_s[0] for other in replay.stretch_replays)
    others = np.delete(u, j, axis=1)
    return Course(stretch.dt_s, t_s - t_s[0], modelled, drive, load, others, t_s - began_s)


def white_columns(whitener: Whitener, channel: int, dt_s: float, signals: Array) -> Array:
    """Increments of signals (m, k), through the filter that the residual went through."""
    k = signals.shape[1]
    same = Whitener(
        np.repeat(whitener.ar_coefficients[:, [channel]], k, axis=1), np.repeat(whitener.innovation_sigma[[channel]], k)
    )
    return whiten_sets(same, block_increments(signals, dt_s)[None])[0, START_SKIPPED_INCREMENTS:]


def hat_functions(x: Array, knots: Array) -> Array:
    """Straight pieces between knots: any continuous function of x (m, knots)."""
    return np.stack([np.interp(x, knots, row) for row in np.eye(len(knots))], axis=1)


def moving_families(c: Course) -> dict[str, Array]:
    """Of an actuator: families that go with how the joint moves, not only with its command."""
    v, du, size = c.smoothed(c.rate(c.modelled_output)), c.rate(c.smoothed(c.input_signal)), np.abs(c.input_signal)
    busy = np.abs(c.other_joint_commands).sum(axis=1)
    turned = np.stack([np.sign(du), np.sign(du) * size], axis=1)
    return {
        "the change of the command": np.concatenate(
            [np.stack([c.input_signal, size, v, c.rate(v)], axis=1), c.integral_of(turned)], axis=1
        ),
        "the load": c.integral_of(
            np.stack([c.gravity_load, v * c.gravity_load, np.abs(v) * c.gravity_load, c.gravity_load**2], axis=1)
        ),
        "the angle": np.concatenate(
            [
                c.integral_of(v[:, None] * np.stack([c.modelled_output, c.modelled_output**2], axis=1)),
                _fourier_columns(c.modelled_output, ANGLE_FOURIER_ORDERS),
            ],
            axis=1,
        ),
        "other joints": np.concatenate(
            [c.integral_of(np.stack([v * busy, np.sign(v) * busy], axis=1)), c.other_joint_commands], axis=1
        ),
    }


def _fourier_columns(q: Array, orders: int) -> Array:
    turns = np.outer(q, np.arange(1, orders + 1))
    return np.concatenate([np.sin(turns), np.cos(turns)], axis=1)


# How a machine still answers to its commands a while later, as families of functions: a linear form with a memory.
RESPONSE_DELAYS_S = np.arange(1, 21) * 0.05
LAG_TIME_CONSTANTS_S = (0.03, 0.1, 0.3, 1.0, 3.0)
LAG_COMMAND_KNOTS = np.array([-1.0, -0.25, -0.06, 0.0, 0.06, 0.25, 1.0])  # of full command
OSCILLATION_FREQUENCIES_HZ = np.geomspace(0.5, 8.0, 9)
OSCILLATION_DAMPING_RATIO = 0.25  # wide enough that an oscillation between two of the frequencies is a sum of both
RESPONSE_FAMILY_NAMES = (
    "echoes",
    "catching up",
    "swings",  # old name, in baselines
    "uneven swings",  # old name, in baselines
    "the other joints' swings",  # old name, in baselines
)


def actuator_responses(c: Course) -> dict[str, Array]:
    """Of one joint's actuator through a stretch: families (m, k)."""
    u, others = c.input_signal, list(c.other_joint_commands.T)
    of_others = [_excited_oscillations(c, other) for other in others] or [np.zeros((len(u), 0))]
    families = (
        np.stack([np.interp(c.t_s - late_s, c.t_s, u) for late_s in RESPONSE_DELAYS_S], axis=1),
        np.concatenate(
            [c.leaky_integral(hat_functions(u, LAG_COMMAND_KNOTS), tau_s) for tau_s in LAG_TIME_CONSTANTS_S], axis=1
        ),
        _excited_oscillations(c, u),
        _excited_oscillations(c, u * np.abs(u)),
        np.concatenate(of_others, axis=1),
    )
    return dict(zip(RESPONSE_FAMILY_NAMES, families, strict=True))


def _excited_oscillations(c: Course, x: Array) -> Array:
    """The oscillations that a signal (m,) excites: both quadratures at each frequency (m, 2 frequencies)."""
    omega = 2.0 * np.pi * OSCILLATION_FREQUENCIES_HZ
    poles = omega * (-OSCILLATION_DAMPING_RATIO + 1j * np.sqrt(1.0 - OSCILLATION_DAMPING_RATIO**2))
    kept = np.exp(poles * c.dt_s)
    rung = _filter_complex_poles(np.ascontiguousarray(x), kept, (kept - 1.0) / poles)
    return np.concatenate([rung.real, rung.imag], axis=1)


@njit(cache=True)
def _filter_complex_poles(
    x: Array, kept: NDArray[np.complex128], taken: NDArray[np.complex128]
) -> NDArray[np.complex128]:
    """z_k = kept z_(k-1) + taken x_(k-1) (m, poles), complex: dz/dt = s z + x with x held, exact at any step."""
    out = np.zeros((len(x), len(kept)), dtype=np.complex128)
    for i in range(1, len(x)):
        for k in range(len(kept)):
            out[i, k] = kept[k] * out[i - 1, k] + taken[k] * x[i - 1]
    return out
