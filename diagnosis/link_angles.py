"""Link-side angles at the times of measurements behind the encoders, for many parameter sets."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.stretches import Stretch
from diagnosis.tables import filled
from machine.effects import kernel
from machine.effects.dynamics import Actuators, drive_joint, simulate
from machine.effects.encoders import true_angles
from machine.effects.layout import ParameterSets
from machine.rotations import Array

COURSE_COLUMNS = [
    kernel.BACKLASH,
    *(kernel.BIAS, kernel.SCALE, kernel.ECC_AMPLITUDE, kernel.ECC_ORDER, kernel.ECC_PHASE),
    *(kernel.FLEX_GAIN, kernel.FLEX_HZ, kernel.FLEX_DAMPING),
]
REMEMBERED = 12
COURSE_S = 0.01  # between two angles of a course: between them 0.01 mm of the tip at 0.2 rad/s^2
ENCODER_COLUMNS = (kernel.BIAS, kernel.SCALE, kernel.ECC_AMPLITUDE)


@dataclass(frozen=True, slots=True)
class Path:
    """The encoders' course through one stretch: t_s (m,), enc (m, n); the plant at its rate, None without actuators."""

    t_s: Array
    enc: Array
    plant: Actuators | None
    courses: dict[bytes, Array] = field(default_factory=dict, compare=False)  # behind play and swing


def paths_of(stretches: tuple[Stretch, ...], plant: Actuators | None) -> tuple[Path, ...]:
    """The course of every stretch that has encoders throughout."""
    out = []
    for one in stretches:
        if one.enc is None or not np.isfinite(one.enc).any(axis=0).all():
            continue
        skip = max(1, int(COURSE_S / one.dt_s + 1e-9))
        at_rate = None
        if plant is not None:
            step = one.dt_s * skip
            at_rate = replace(plant, cycle_s=step, log_cycle_s=step)
        out.append(Path(one.t_s[::skip], np.ascontiguousarray(filled(one.enc)[::skip]), at_rate))
    return tuple(out)


def inside(paths: tuple[Path, ...], t_s: Array, margin_s: float = 0.0) -> NDArray[np.int64]:
    """Which path each time (m,) falls into, -1 for none."""
    which = np.full(len(t_s), -1, dtype=np.int64)
    for k, path in enumerate(paths):
        which[(t_s >= path.t_s[0] + margin_s) & (t_s <= path.t_s[-1] - margin_s)] = k
    return which


def link_angles(paths: tuple[Path, ...], sets: ParameterSets, which: int, at: NDArray[np.int64], t_s: Array) -> Array:
    """Link-side angles (m, n) of one set at times (m,) that lie in paths `at` (m,)."""
    out = np.zeros((len(t_s), sets.joint.shape[1]))
    for k in np.unique(at):
        path, rows = paths[int(k)], at == k
        course = _behind_joint(path, sets, which)
        out[rows] = np.stack(
            [np.interp(t_s[rows], path.t_s, column) for column in (path.enc if course is None else course).T], axis=1
        )
        if course is None:  # the encoders' map is smooth: after the interpolation it costs a tenth
            out[rows] = true_angles(sets, out[rows], which)
    return out


def _behind_joint(path: Path, sets: ParameterSets, which: int) -> Array | None:
    """Link-side angles at the log's rows (m, n); None without play and swing, where the encoders tell them."""
    if path.plant is None or not np.any(sets.joint[which][:, [kernel.BACKLASH, kernel.FLEX_GAIN]]):
        return None
    key = sets.joint[which][:, COURSE_COLUMNS].tobytes()
    if key not in path.courses:
        one = ParameterSets(sets.joint[which : which + 1].copy(), sets.machine[which : which + 1].copy())
        if len(path.courses) >= REMEMBERED:
            path.courses.pop(next(iter(path.courses)))
        path.courses[key] = simulate(path.plant, one, drive_joint(path.plant, path.enc)).link[0]
    return path.courses[key]


def without_encoders(sets: ParameterSets) -> ParameterSets:
    """The sets with true encoders, for angles that are the link's already."""
    joint = sets.joint.copy()
    joint[..., list(ENCODER_COLUMNS)] = 0.0
    return ParameterSets(joint, sets.machine)
