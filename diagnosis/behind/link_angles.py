"""Link-side angles at the times of measurements behind the encoders, for many parameter sets."""

from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from diagnosis.behind.quiet_encoders import smooth_encoders
from diagnosis.behind.stairs import smooth_encoder_steps, steps_visible_at_tip
from diagnosis.log.tables import fill_gaps
from diagnosis.replay.stretches import Stretch
from diagnosis.search.candidates import OSCILLATION_EFFECTS, Candidate, arm_candidates
from machine.effects import kernel
from machine.effects.encoders import true_angles
from machine.effects.layout import ParameterSets
from machine.rotations import Array

LINK_ANGLE_PARAMETER_COLUMNS = [
    kernel.BACKLASH,
    *(kernel.BIAS, kernel.SCALE, kernel.ECC_AMPLITUDE, kernel.ECC_ORDER, kernel.ECC_PHASE),
    *(kernel.FLEX_GAIN, kernel.FLEX_HZ, kernel.FLEX_DAMPING),
    *(kernel.KNOWN_GAIN, kernel.KNOWN_HZ, kernel.KNOWN_DAMPING),
]
CACHE_ENTRIES_PER_JOINT = 36  # of a joint: both sides of its play, too
BACKLASH_TRAVEL_RATIO_MIN = 2.0  # of a play, that a joint goes for its first side to be a matter of where it began
BACKLASH_SIDES = (-1.0, 0.0, 1.0)
PATH_SAMPLE_PERIOD_S = 0.01  # between two angles of a course: between them 0.01 mm of the tip at 0.2 rad/s^2
DYNAMICS_ROW_PERIOD_MAX_S = 0.1  # between logged rows: a longer one shows neither play's reversals nor an oscillation
ENCODER_PARAMETER_COLUMNS = (kernel.BIAS, kernel.SCALE, kernel.ECC_AMPLITUDE)


@dataclass(frozen=True, slots=True)
class Path:
    """The encoders' course through one stretch: t_s (m,), `encoder_angles` (m, n). `step_s`: between its rows, for
    play and oscillation; None where rows are too rare to follow them: neither is modelled then. `coarse_rad`: steps of
    the encoders that are seen behind them, 0 of finer ones.
    """

    t_s: Array
    encoder_angles: Array
    step_s: float | None
    coarse_rad: tuple[float, ...] = ()
    # Link-side angles, behind play and oscillation.
    link_angle_cache: dict[tuple[int, float, bytes], Array] = field(default_factory=dict, compare=False)


def paths_of(stretches: tuple[Stretch, ...]) -> tuple[Path, ...]:
    """The course of every stretch that has encoders throughout."""
    out = []
    for stretch in stretches:
        if stretch.enc is None or not np.isfinite(stretch.enc).any(axis=0).all():
            continue
        skip = max(1, int(PATH_SAMPLE_PERIOD_S / stretch.dt_s + 1e-9))
        step_s = stretch.dt_s * skip if stretch.dt_s <= DYNAMICS_ROW_PERIOD_MAX_S else None
        coarse = steps_visible_at_tip(np.zeros(stretch.enc.shape[1]) if stretch.enc_step is None else stretch.enc_step)
        quiet = np.ascontiguousarray(
            smooth_encoders(smooth_encoder_steps(fill_gaps(stretch.enc), coarse, stretch.dt_s), stretch.dt_s)[::skip]
        )
        out.append(Path(stretch.t_s[::skip], quiet, step_s, tuple(coarse.tolist())))
    return tuple(out)


def is_logged_densely(paths: tuple[Path, ...]) -> bool:
    """Whether the courses are logged often enough for play and oscillation."""
    return bool(paths) and all(path.step_s is not None for path in paths)


def largest_encoder_steps(paths: tuple[Path, ...], n: int) -> Array:
    """The largest step (n,) [rad] of each joint's encoder along any course; 0 of fine ones."""
    steps = [np.array(path.coarse_rad) for path in paths if path.coarse_rad]
    return np.max([np.zeros(n), *steps], axis=0)


def candidates_behind(joints: tuple[int, ...], paths: tuple[Path, ...]) -> tuple[Candidate, ...]:
    """The arm's effects that points and corners along these courses can show.

    Why: an oscillation behind a coarse encoder smooths its stairs, and would be blamed for that.
    """
    coarse = np.nonzero(largest_encoder_steps(paths, max(joints, default=0)))[0] + 1
    return tuple(
        candidate
        for candidate in arm_candidates(joints, is_logged_densely(paths))
        if candidate.name not in OSCILLATION_EFFECTS or candidate.joint not in coarse
    )


def path_index(paths: tuple[Path, ...], t_s: Array, margin_s: float = 0.0) -> NDArray[np.int64]:
    """Which path each time (m,) falls into, -1 for none."""
    which = np.full(len(t_s), -1, dtype=np.int64)
    for k, path in enumerate(paths):
        which[(t_s >= path.t_s[0] + margin_s) & (t_s <= path.t_s[-1] - margin_s)] = k
    return which


def link_angles(
    paths: tuple[Path, ...], sets: ParameterSets, which: int, at: NDArray[np.int64], t_s: Array, side: float = 0.0
) -> Array:
    """Link-side angles (m, n) of one set at times (m,) that lie in paths `at` (m,).

    `side`: of its play, on which every joint stands that moves later, where its course begins: -1, 0 (the middle) or 1.
    """
    n = sets.joint_parameters.shape[1]
    out, times = np.zeros((len(t_s), n)), np.ascontiguousarray(t_s, dtype=float)
    encoders = np.ones((len(paths), n), dtype=bool)
    loose = np.any(sets.joint_parameters[which][:, [kernel.BACKLASH, kernel.FLEX_GAIN, kernel.KNOWN_GAIN]], axis=1)
    keys = [
        sets.joint_parameters[which, j, LINK_ANGLE_PARAMETER_COLUMNS].tobytes() if loose[j] else b"" for j in range(n)
    ]
    for k in np.unique(at):
        path = paths[k]
        for j in range(n):
            encoders[k, j] = path.step_s is None or not loose[j]
            values = path.encoder_angles[:, j]
            if path.step_s is not None and loose[j]:
                values = _behind_joint(path, path.step_s, sets.joint_parameters[which, j], j, keys[j], side)
            _interpolate_cubic(path.t_s, values, at, k, times, out[:, j])
    rows = encoders[at]
    # the encoders' map is smooth: after the interpolation it costs a tenth
    return np.where(rows, true_angles(sets, out, which), out) if rows.any() else out


@njit(cache=True)
def _interpolate_cubic(
    at_s: Array, values: Array, path_of: NDArray[np.int64], path: int, times_s: Array, out: Array
) -> None:
    """Those of `out` (m,) that lie in `path`: values (k,) at at_s (k,), evenly apart, by the cubic through the four
    nearest; straight at the ends, held beyond them.

    Why no lines: a joint that starts at 2 rad/s^2 is 0.1 mm of the tip away from them, as much as a tracker's noise.
    """
    last = len(at_s) - 1
    for i in range(len(times_s)):
        if path_of[i] != path:
            continue
        right = np.searchsorted(at_s, times_s[i], side="right")
        if right == 0 or right > last:
            out[i] = values[0 if right == 0 else last]
            continue
        s = (times_s[i] - at_s[right - 1]) / (at_s[right] - at_s[right - 1])
        a, b = values[right - 1], values[right]
        out[i] = a + s * (b - a)
        if 1 < right < last:
            before, after = b - 2.0 * a + values[right - 2], values[right + 1] - 2.0 * b + a
            out[i] -= s * (1.0 - s) / 6.0 * ((2.0 - s) * before + (1.0 + s) * after)


def _behind_joint(path: Path, step_s: float, effects: Array, j: int, key: bytes, side: float) -> Array:
    """Link-side angles of joint j (0-based), which has play or oscillates, at the path's rows (m,); joint by joint,
    since most sets differ in one.
    """
    if side and np.ptp(path.encoder_angles[:, j]) < BACKLASH_TRAVEL_RATIO_MIN * effects[kernel.BACKLASH]:
        side = 0.0
    if (j, side, key) not in path.link_angle_cache:
        if len(path.link_angle_cache) >= CACHE_ENTRIES_PER_JOINT * path.encoder_angles.shape[1]:
            path.link_angle_cache.pop(next(iter(path.link_angle_cache)))
        path.link_angle_cache[j, side, key] = kernel.link_side_course(
            effects, np.ascontiguousarray(path.encoder_angles[:, j]), step_s, side
        )
    return path.link_angle_cache[j, side, key]


def without_encoders(sets: ParameterSets) -> ParameterSets:
    """The sets with true encoders, for angles that are the link's already."""
    joint = sets.joint_parameters.copy()
    joint[..., list(ENCODER_PARAMETER_COLUMNS)] = 0.0
    return ParameterSets(joint, sets.machine_parameters)
