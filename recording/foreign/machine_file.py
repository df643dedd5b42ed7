"""machine.toml of an arm that comes with a log of another system: its joints, a nominal drive, its points."""

import itertools
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machine.rotations import Array
from recording.foreign.mapping import Actuator, CommandKind
from recording.foreign.urdf_ends import ChosenChain

DEFAULT_VELOCITY_MAX = 3.0  # [rad/s or m/s], where neither URDF nor mapping has one and nothing faster was commanded
DEFAULT_BANDWIDTH_HZ = 5.0  # of the position loop: industrial arms lie between 3 and 10
DEFAULT_DAMPING_RATIO = 1.0
FITTED_COMMAND_MIN_FRAC = 0.25  # share of the full command: dead bands end below
VELOCITY_LOOP_RATIO = 5.0  # of the velocity loop's bandwidth to the position loop's, as loops in one another are tuned
FITTED_BANDWIDTH_MIN_HZ = 0.5
FITTED_LOOP_RATIO_RANGE = (2.0, 20.0)  # a velocity loop below twice the position loop makes it oscillate
FITTED_PERIOD_MIN_STEPS = 10.0  # a loop faster than this many rows of the log cannot be seen in it
MODEL_CYCLE_MAX_S = 4e-3  # the model's cycle is a whole part of the log's, at most this


@dataclass(frozen=True, slots=True)
class DriveModel:
    """The nominal drive of every joint: kind, velocity of a full command (n,) [rad/s or m/s], and what was assumed."""

    command_kind: CommandKind
    velocity_max: tuple[float, ...]
    kp_frac_per_rad: tuple[float, ...]
    velocity_loop_hz: tuple[float, ...]
    damping_ratio: float
    notes: tuple[str, ...]


def drive_model(wanted: Actuator, command_kind: str, limits: Sequence[float], commanded: Sequence[float]) -> DriveModel:
    """The nominal drive.

    Model:  velocity of a joint = velocity_max u behind a second order of `velocity_bandwidth_hz`; u is the velocity
            command over velocity_max, or kp (reference - encoder) with kp velocity_max = 2 pi bandwidth_hz.
    Args:   limits: velocities of the URDF (n,), inf without; commanded: largest velocity commands (n,), 0 without.
    """
    given: CommandKind = (
        "velocity" if command_kind == "velocity" else "valve" if command_kind == "valve" else "position"
    )
    kind = wanted.kind or given
    fastest = []
    for limit, largest in zip(limits, commanded, strict=True):
        known = limit if math.isfinite(limit) else DEFAULT_VELOCITY_MAX
        fastest.append(wanted.velocity_max or max(known, 1.05 * largest))
    position_hz, velocity_hz = (
        wanted.bandwidth_hz or DEFAULT_BANDWIDTH_HZ,
        wanted.velocity_bandwidth_hz or VELOCITY_LOOP_RATIO * DEFAULT_BANDWIDTH_HZ,
    )
    damping = wanted.damping or DEFAULT_DAMPING_RATIO
    kp = tuple(2.0 * math.pi * position_hz / speed for speed in fastest)
    notes = [f"nominal {kind}-controlled drive: velocity loop of {velocity_hz:g} Hz, damping {damping:g}"]
    if kind == "position":
        notes.append(f"position loop of {position_hz:g} Hz without feed-forward")
    if not (wanted.bandwidth_hz and wanted.velocity_bandwidth_hz):
        notes.append(
            "assumed, not measured: give yours under [actuator] of the mapping file; the gap is the gap to these"
        )
    return DriveModel(kind, tuple(fastest), kp, (velocity_hz,) * len(kp), damping, tuple(notes))


def with_fitted_gains(drive: DriveModel, t_s: Array, q: Array | None, u: Array) -> DriveModel:
    """The drive with the velocity of a full valve command that this recording shows, joint by joint: no drawing has it.

    Model: least squares through 0 of the encoder's velocity over the command, where it is beyond any dead band.
    Args:  t_s: (m,) [s], q: (m, n) [rad or m], u: (m, n) [share of the full command].
    """
    if q is None or len(t_s) < 3:
        return drive
    fastest = list(drive.velocity_max)
    for k in range(len(fastest)):
        speed, command = np.gradient(q[:, k], t_s), u[:, k]
        good = np.isfinite(speed) & (np.abs(command) > FITTED_COMMAND_MIN_FRAC)
        gain = float(speed[good] @ command[good] / (command[good] @ command[good])) if good.sum() > 2 else 0.0
        fastest[k] = abs(gain) or fastest[k]
    kp = tuple(
        gain * before / now
        for gain, before, now in zip(drive.kp_frac_per_rad, drive.velocity_max, fastest, strict=True)
    )
    note = "velocities of a full command are fitted to this recording, which hides an error of the gain"
    return replace(
        drive, velocity_max=tuple(fastest), kp_frac_per_rad=kp, notes=(*drive.notes, f"{note}; give velocity_max")
    )


def with_fitted_position_loops(drive: DriveModel, t_s: Array, q: Array | None, q_ref: Array | None) -> DriveModel:
    """The drive with the bandwidth of each joint's position loop that this recording shows: a robot log states none.

    Model: least output error of the closed loop from the reference to the encoder; a joint whose reference stands still
           keeps the assumed bandwidths.
    Args:  t_s: (m,) [s], q, q_ref: (m, n) [rad or m].
    """
    if q is None or q_ref is None or len(t_s) < 3:
        return drive
    step_s = float(np.median(np.diff(t_s)))
    grid_s = np.arange(t_s[0], t_s[-1], step_s)
    highest_hz = 1.0 / (FITTED_PERIOD_MIN_STEPS * step_s)
    kp, velocity_hz, found_hz = list(drive.kp_frac_per_rad), list(drive.velocity_loop_hz), []
    for k, velocity_max in enumerate(drive.velocity_max):
        good = np.isfinite(q[:, k]) & np.isfinite(q_ref[:, k])
        if good.sum() < 3 or np.ptp(q_ref[good, k]) == 0.0:
            continue
        reference = np.interp(grid_s, t_s[good], q_ref[good, k])
        encoder = np.interp(grid_s, t_s[good], q[good, k])
        position_hz, velocity_hz[k] = _fitted_loops_hz(reference, encoder, step_s, drive.damping_ratio, highest_hz)
        kp[k] = 2.0 * math.pi * position_hz / velocity_max
        found_hz.append(f"{position_hz:.3g}")
    if not found_hz:
        return drive
    note = f"position loops of {', '.join(found_hz)} Hz are fitted to this recording, which hides an error of the gain"
    return replace(
        drive,
        kp_frac_per_rad=tuple(kp),
        velocity_loop_hz=tuple(velocity_hz),
        notes=(*drive.notes, f"{note}; give bandwidth_hz"),
    )


def _fitted_loops_hz(
    reference: Array, encoder: Array, step_s: float, damping_ratio: float, highest_hz: float
) -> tuple[float, float]:
    """Bandwidths of the position loop and of the velocity loop in it."""
    from scipy.signal import bilinear, lfilter

    def miss(log_hz: float, log_ratio: float) -> float:
        position = 2.0 * math.pi * math.exp(log_hz)
        velocity = position * math.exp(log_ratio)
        gain = position * velocity**2
        b, a = bilinear([gain], [1.0, 2.0 * damping_ratio * velocity, velocity**2, gain], 1.0 / step_s)
        return float(np.var(lfilter(b, a, reference - reference[0]) - encoder))  # less the mean: a zero is not a loop's

    lower = np.log([FITTED_BANDWIDTH_MIN_HZ, FITTED_LOOP_RATIO_RANGE[0]])
    upper = np.log([max(highest_hz, FITTED_BANDWIDTH_MIN_HZ), FITTED_LOOP_RATIO_RANGE[1]])
    best = lower
    for _ in range(6):  # each grid spans two steps of the one before: 0.1 % at the end
        grids = np.linspace(lower, upper, 11)
        best = np.array(min(itertools.product(*grids.T), key=lambda pair: miss(*pair)))
        step = grids[1] - grids[0]
        lower, upper = np.maximum(best - step, lower), np.minimum(best + step, upper)
    return math.exp(best[0]), math.exp(best[0] + best[1])


def model_and_log_cycle_s(log_step_s: float) -> tuple[float, float]:
    """The model's cycle and the log's [s]: the log's is a whole multiple."""
    cycle_s = log_step_s / max(1, math.ceil(log_step_s / MODEL_CYCLE_MAX_S - 1e-6))
    return cycle_s, log_step_s


def machine_toml(
    name: str,
    joints: Sequence[str],
    sliding: Sequence[bool],
    drive: DriveModel,
    log_step_s: float,
    chain: ChosenChain | None,
    urdf_file: str,
    points: dict[str, int],
) -> str:
    """The file's text; geometry is the URDF's where there is one."""
    lines = ["# Made by `longreach recording convert`. Assumed values are marked; put in yours.", "[machine]"]
    lines += [f"name = {json.dumps(name)}", "gravity_base_m_s2 = [0.0, 0.0, -9.81]", ""]
    if chain is not None:
        lines += ["[urdf]", f"file = {json.dumps(urdf_file)}"]
        lines += [f"base_link = {json.dumps(chain.base_link)}", f"tip_link = {json.dumps(chain.tip_link)}", ""]
    lines += [f"# {note}" for note in drive.notes]
    for k, joint in enumerate(joints):
        lines += ["[[joint]]", f"name = {json.dumps(joint)}", f'type = "{"prismatic" if sliding[k] else "revolute"}"']
        lines += [
            f"velocity_gain_rad_s = {drive.velocity_max[k]:.9g}",
            f"valve_frequency_hz = {drive.velocity_loop_hz[k]:.9g}",
        ]
        lines += [f"valve_damping = {drive.damping_ratio:.9g}", f"kp_frac_per_rad = {drive.kp_frac_per_rad[k]:.9g}", ""]
    cycle_s, log_cycle_s = model_and_log_cycle_s(log_step_s)
    lines += ["[plc]", f"cycle_s = {cycle_s!r}", f"log_cycle_s = {log_cycle_s!r}", "transport_delay_s = 0.0", ""]
    for point, joint in points.items():
        lines += [f"[points.{json.dumps(point)}] # where on the link is found", f"joint = {joint}", ""]
    return "\n".join(lines)
