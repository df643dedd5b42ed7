"""The plant driven by what a recording holds, without a clock: its references by the PLC's controller, or its commands.

Nothing of the presets' realism is in it, only the effects of the machine file: the arm is rigid, and bends by what the
file says at the posture it is in.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.description import Machine
from machine.effects.entries import EffectEntry
from machine.rotations import Array
from sim_plc.diagnosed import CHANGES, with_effects
from sim_plc.draw_world import draw_world
from sim_plc.plant.hydraulics import play_operator, spool_opening
from sim_plc.plant.kernel import OUTPUT, Parameters, State, advance_rigid
from sim_plc.plant.plant import Plant
from sim_plc.plant.statics import frames, gravity_torques
from sim_plc.plant.tree import MOTOR_JOINT_INDICES, N_TREE_JOINTS, Tree
from sim_plc.plc.status import valve_commands
from sim_plc.presets import PresetError
from sim_plc.world import World
from tests.unit.sim_plc.command_side import NAMES as SIDE_NAMES
from tests.unit.sim_plc.command_side import controller_settings, side_numbers

PRESET, SEED = "ideal", 1  # the nominal model, nothing drawn
SAG = "gravity_sag"
NOT_HERE = {"rolling_shutter"}  # all rows of a picture are exposed together here
STEP_S = 1e-3


# The walk through the simulator's cycles along a recording, compiled: encoders, controller, command, plant.


class Side(NamedTuple):
    """What acts between the controller and the spool, (n,) each: see `command_side`."""

    kp: Array
    pt1_share: Array
    limit: Array
    hysteresis: Array
    lag_share: Array
    dead: Array
    full_flow: Array
    forward_gain: Array
    resolution: Array


@njit(cache=True, error_model="numpy")
def run_cycles(
    par: Parameters,
    state: State,
    side: Side,
    closed: bool,
    given: Array,
    rows: NDArray[np.int64],
    q_out: Array,
    u_out: Array,
    angles_out: Array,
) -> None:
    """Cycles of 1 ms of the rigid plant. `given` (cycles, n): references if `closed`, else commands.

    What stands at `rows` is noted. `angles_out`: (rows, joints of the tree), motors behind their play.
    """
    n = given.shape[1]
    q, u, lagged, command = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    held, slow = np.zeros(n), np.zeros(n)
    if not closed:
        held[:] = given[0]
        slow[:] = given[0]
    at = 0
    for k in range(given.shape[0]):
        for j in range(n):
            q[j] = np.round(state.q[par.motor_joints[j]] / side.resolution[j]) * side.resolution[j]
        if closed:
            valve_commands(given[k], q, side.kp, side.pt1_share, 1.0, lagged, u)
        else:
            u[:] = given[k]
        while at < rows.shape[0] and rows[at] == k:
            q_out[at] = q
            u_out[at] = u
            angles_out[at] = state.q
            for j in range(n):
                angles_out[at, par.motor_joints[j]] = state.joint_states[j, OUTPUT]
            at += 1
        for j in range(n):
            held[j] = play_operator(held[j], min(max(u[j], -side.limit[j]), side.limit[j]), side.hysteresis[j])
            slow[j] += side.lag_share[j] * (held[j] - slow[j])
            opened = spool_opening(slow[j], side.dead[j]) * side.full_flow[j]
            command[j] = opened * side.forward_gain[j] if opened > 0.0 else opened
        advance_rigid(par, state, command, 1)


@dataclass(frozen=True, slots=True)
class Offline:
    """A machine file as the simulator runs it here. `side`: effects that act before the spool; `bending`: behind the
    encoders.
    """

    world: World
    side: tuple[EffectEntry, ...]
    bending: "Bending"


@dataclass(frozen=True, slots=True)
class Bending:
    """How far each joint (6,) [rad/(N m)] gives way to the weights behind it, about its own axis."""

    compliance_rad_nm: Array
    gravity_base_m_s2: Array

    def bent(self, tree: Tree, angles: Array) -> Array:
        """Angles of the tree's joints (11,) [rad] with the sag of that posture."""
        if not self.compliance_rad_nm.any():
            return angles
        bent = angles.copy()
        bent[MOTOR_JOINT_INDICES] += (
            self.compliance_rad_nm * gravity_torques(tree, self.gravity_base_m_s2, angles)[MOTOR_JOINT_INDICES]
        )
        return bent


@dataclass(frozen=True, slots=True)
class Course:
    """What the plant did at the asked times (m,): encoders, valve commands (m, n), true angles of its tree's joints."""

    q_encoder: Array
    u: Array
    angles: Array
    tree: Tree
    bending: Bending

    def at(self, t_s: Array, wanted_s: Array) -> "Course":
        """The same at other times (k,) [s], linear between those of its rows t_s (m,)."""
        q, u, angles = (
            np.stack([np.interp(wanted_s, t_s, column) for column in rows.T], axis=1)
            for rows in (self.q_encoder, self.u, self.angles)
        )
        return Course(q, u, angles, self.tree, self.bending)

    def tcp_poses(self) -> Array:
        """True Ts_base_tcp (m, 4, 4)."""
        Ts = np.tile(np.eye(4), (len(self.angles), 1, 1))
        for T, angles in zip(Ts, self.angles, strict=True):
            R, p = frames(self.tree, self.bending.bent(self.tree, angles))
            T[:3, :3], T[:3, 3] = R[-1], p[-1]
        return Ts @ self.tree.T_last_tcp


def plain_world(machine: Machine) -> World:
    """The simulator's own machine without any realism: rigid, without oil, in the middle of whatever play it is given.

    Raises: PresetError: not the six-joint crane that the plant is made of.
    """
    if len(machine.joints) != 6:
        raise PresetError(f"the simulator's plant is a crane with 6 joints; the machine file has {len(machine.joints)}")
    world = draw_world(replace(machine, effects=()), PRESET, SEED)
    arm = replace(world.plant.kinematics, play_start_frac=np.zeros(6))
    return replace(world, plant=replace(world.plant, kinematics=arm))


def offline(plain: World, entries: tuple[EffectEntry, ...]) -> Offline:
    """A plain machine with these effects.

    Raises: PresetError: one that neither the plant nor what is before it can have.
    """
    side = tuple(effect for effect in entries if effect.name in SIDE_NAMES)
    rest = tuple(effect for effect in entries if effect.name not in (*SIDE_NAMES, SAG))
    unknown = sorted({effect.name for effect in rest} - (set(CHANGES) - NOT_HERE))
    if unknown:
        raise PresetError(f"effect {unknown[0]} cannot be simulated by the plant")
    compliance = np.zeros(6)
    for effect in entries:
        if effect.name == SAG:
            compliance[(effect.joint or 1) - 1] += effect.value("compliance_rad_nm")
    world = with_effects(replace(plain, nominal=replace(plain.nominal, effects=rest)))
    return Offline(world, side, Bending(compliance, world.plant.inertia.gravity_base_m_s2))


def follow_reference(one: Offline, t_s: Array, q_ref: Array, q_start: Array) -> Course:
    """The loop closed by the PLC's controller: received references (m, n) [rad] at t_s (m,) [s], linear in between."""
    return _run(one, t_s, _between(t_s, q_ref), q_start, closed=True)


def follow_sent(one: Offline, t_s: Array, sent_s: Array, sent: Array, q_start: Array) -> Course:
    """The same from the references as sent (k, n) at sent_s (k,) [s]: held, and late by the link's delay."""
    delay_s = one.world.nominal.transport_delay_s + side_numbers(one.side, 6, STEP_S).delay_s
    cycles = t_s[0] + STEP_S * np.arange(_count(t_s)) - delay_s
    latest = np.maximum(np.searchsorted(sent_s, cycles + 1e-9, side="right") - 1, 0)
    return _run(one, t_s, sent[latest], q_start, closed=True)


def follow_commands(one: Offline, t_s: Array, u: Array, q_start: Array) -> Course:
    """The plant alone: valve commands (m, n) at t_s (m,), linear in between."""
    return _run(one, t_s, _between(t_s, u), q_start, closed=False)


def at_rest(one: Offline, q: Array) -> Array:
    """True T_base_tcp (4, 4) with the encoders at rest at q (n,)."""
    plant = Plant(one.world.plant, q)
    angles = plant.state.q.copy()
    angles[MOTOR_JOINT_INDICES] = plant.state.joint_states[:, OUTPUT]
    none = np.zeros((1, 6))
    return np.asarray(Course(none, none, angles[None], plant.tree, one.bending).tcp_poses()[0])


def _run(one: Offline, t_s: Array, given: Array, q_start: Array, closed: bool) -> Course:
    """Cycle by cycle as the PLC does it: encoders, command, then the plant moves on by 1 ms."""
    plant = Plant(one.world.plant, q_start)
    rows = np.rint((t_s - t_s[0]) / STEP_S).astype(np.int64)
    q, u, angles = np.zeros((len(t_s), 6)), np.zeros((len(t_s), 6)), np.zeros((len(t_s), N_TREE_JOINTS))
    run_cycles(
        plant.parameters, plant.state, _side(one), closed, np.ascontiguousarray(given, dtype=float), rows, q, u, angles
    )
    return Course(q, u, angles, plant.tree, one.bending)


def _side(one: Offline) -> Side:
    settings, numbers = controller_settings(one.world.nominal, one.side, STEP_S), side_numbers(one.side, 6, STEP_S)
    return Side(
        kp=np.array(settings.kp_frac_per_rad),
        pt1_share=np.array(settings.pt1_share),
        limit=numbers.limit,
        hysteresis=numbers.hysteresis,
        lag_share=numbers.lag_share,
        dead=numbers.dead,
        full_flow=numbers.full_flow,
        forward_gain=numbers.forward_gain,
        resolution=2.0 * np.pi / one.world.plant.kinematics.encoder_counts_rev,
    )


def _count(t_s: Array) -> int:
    return round((t_s[-1] - t_s[0]) / STEP_S) + 1


def _between(t_s: Array, values: Array) -> Array:
    """Logged rows at every cycle of 1 ms."""
    t = t_s[0] + STEP_S * np.arange(_count(t_s))
    return np.stack([np.interp(t, t_s, column) for column in values.T], axis=1)
