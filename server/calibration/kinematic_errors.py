"""What the kinematics of one machine may have wrong, as parameters: lengths, twists, joint zeros, sag, play.

The nominal model is the machine file's. A crane differs from it by millimetres and tenths of a degree, and sags; near
one posture that bends the map from encoders to the tool by a few per cent, smoothly and not at will: only as these
parameters can. That is what makes it possible to learn the map around a posture from one metre of path.
"""

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.chain import chain_of
from machine.description import Machine
from server.calibration.contracts import Array

Integers = NDArray[np.int64]


class ErrorKind(IntEnum):
    """Which number of a joint is wrong."""

    LENGTH_A = 0
    LENGTH_D = 1
    TWIST = 2
    ZERO = 3
    COMPLIANCE = 4
    PLAY = 5


@dataclass(frozen=True, slots=True)
class ErrorPrior:
    """How wrong a machine of this class may be, before anything was seen. Standard deviations, except the mean sag.

    Compliance [rad/(N m)] acts about the joint's axis, under the weight of all that hangs on it (masses of the machine
    file). It is given for the joints whose booms bend; those of the others stay zero. Play is its whole width [rad],
    between the encoder and what it turns (`play.py`). Lengths by joint, those beyond the list like its last.
    Source:  tolerances of the class (decision 8, docs/decisions): built lengths 3.5 mm, lengths inside the
             machined wrist and between neighbouring bores 0.5 mm, bores parallel to 0.1 mm in 0.3 m, zeros 0.25 deg;
             compliance and play: mean and sd of the ranges stated for springs, slew and wrists.
    """

    sigma_a_m: tuple[float, ...] = (3.5e-3, 3.5e-3, 3.5e-3, 5e-4, 5e-4, 5e-4)
    sigma_d_m: tuple[float, ...] = (3.5e-3, 5e-4, 3.5e-3, 3.5e-3, 5e-4, 3.5e-3)
    sigma_twist_rad: float = float(np.deg2rad(0.02))
    sigma_zero_rad: float = float(np.deg2rad(0.25))
    mean_compliance: tuple[float, ...] = (0.0, 1.02e-6, 1.53e-6)  # boom of 190 kg: 2 to 4 mm at its end
    sigma_compliance: tuple[float, ...] = (0.0, 0.3e-6, 0.45e-6)
    mean_play_rad: tuple[float, ...] = (1.25e-3, 0.0, 0.0, 3.05e-3, 3.05e-3, 3.05e-3)
    sigma_play_rad: tuple[float, ...] = (4.5e-4, 0.0, 0.0, 1.3e-3, 1.3e-3, 1.3e-3)


def usual_play(n_joints: int) -> Array:
    """About how wide the play of each joint of this class is (n,) [rad]."""
    return np.concatenate([ErrorPrior().mean_play_rad, np.zeros(n_joints)])[:n_joints]


_STEPS = {
    ErrorKind.LENGTH_A: 1e-4,
    ErrorKind.LENGTH_D: 1e-4,
    ErrorKind.TWIST: 1e-5,
    ErrorKind.ZERO: 1e-5,
    ErrorKind.COMPLIANCE: 1e-8,
    ErrorKind.PLAY: 1e-5,
}


@dataclass(frozen=True, slots=True)
class ErrorModel:
    """The nominal chain with p parameters that may be off.

    parameter_kinds, parameter_joints, prior_mean, prior_sigma (p,). derivative_steps (p,): for numerical derivatives.
    """

    dh_a_m: Array
    dh_d_m: Array
    dh_alpha_rad: Array
    theta_offset: Array
    mass_kg: Array
    com_m: Array
    gravity_base: Array
    T_flange_tcp: Array
    parameter_kinds: Integers
    parameter_joints: Integers
    prior_mean: Array
    prior_sigma: Array
    derivative_steps: Array
    parameter_names: tuple[str, ...] = field(default=())

    @property
    def n_joints(self) -> int:
        """Joints of the chain."""
        return len(self.dh_a_m)

    @property
    def n(self) -> int:
        """Parameters that may be off."""
        return len(self.prior_mean)


def error_model(machine: Machine, prior: ErrorPrior | None = None) -> ErrorModel:
    """The parameters of a machine and how wrong they may be."""
    believed = prior or ErrorPrior()
    n = len(machine.joints)
    mean_compliance, sigma_compliance, mean_play, sigma_play = (
        np.concatenate([values, np.zeros(n)])[:n]
        for values in (
            believed.mean_compliance,
            believed.sigma_compliance,
            believed.mean_play_rad,
            believed.sigma_play_rad,
        )
    )
    rows = []
    for j in range(n):
        rows += [
            (ErrorKind.LENGTH_A, j, 0.0, _of_joint(believed.sigma_a_m, j)),
            (ErrorKind.LENGTH_D, j, 0.0, _of_joint(believed.sigma_d_m, j)),
            (ErrorKind.TWIST, j, 0.0, believed.sigma_twist_rad),
            (ErrorKind.ZERO, j, 0.0, believed.sigma_zero_rad),
            (ErrorKind.COMPLIANCE, j, mean_compliance[j], sigma_compliance[j]),
            (ErrorKind.PLAY, j, mean_play[j], sigma_play[j]),
        ]
    kept = [row for row in rows if row[3] > 0.0]
    chain = chain_of(machine)
    return ErrorModel(
        dh_a_m=chain.dh_a_m,
        dh_d_m=chain.dh_d_m,
        dh_alpha_rad=chain.dh_alpha_rad,
        theta_offset=chain.theta_offset,
        mass_kg=np.array([joint.mass_kg for joint in machine.joints]),
        com_m=np.array([joint.com_m for joint in machine.joints]),
        gravity_base=np.asarray(machine.gravity_base_m_s2, dtype=float),
        T_flange_tcp=chain.T_flange_tcp,
        parameter_kinds=np.array([row[0] for row in kept], dtype=np.int64),
        parameter_joints=np.array([row[1] for row in kept], dtype=np.int64),
        prior_mean=np.array([row[2] for row in kept]),
        prior_sigma=np.array([row[3] for row in kept]),
        derivative_steps=np.array([_STEPS[row[0]] for row in kept]),
        parameter_names=tuple(f"{machine.joints[row[1]].name} {row[0].name.lower()}" for row in kept),
    )


def _of_joint(values: tuple[float, ...], joint: int) -> float:
    return values[min(joint, len(values) - 1)]


@njit(cache=True, nogil=True)
def _compute_link_poses(a: Array, d: Array, alpha: Array, theta: Array, out: Array) -> None:
    """Poses of all links in base (n + 1, 4, 4), in place (eq. 23-24)."""
    out[0] = np.eye(4)
    T_i = np.zeros((4, 4))
    T_i[3, 3] = 1.0
    for i in range(a.shape[0]):
        c, s = np.cos(theta[i]), np.sin(theta[i])
        ca, sa = np.cos(alpha[i]), np.sin(alpha[i])
        T_i[0, 0], T_i[0, 1], T_i[0, 2], T_i[0, 3] = c, -s * ca, s * sa, a[i] * c
        T_i[1, 0], T_i[1, 1], T_i[1, 2], T_i[1, 3] = s, c * ca, -c * sa, a[i] * s
        T_i[2, 1], T_i[2, 2], T_i[2, 3] = sa, ca, d[i]
        for r in range(4):
            for k in range(4):
                total = 0.0
                for m in range(4):
                    total += out[i, r, m] * T_i[m, k]
                out[i + 1, r, k] = total


@njit(cache=True, nogil=True)
def _gravity_moment(links: Array, joint: int, mass: Array, com: Array, gravity: Array) -> float:
    """Moment of gravity about a joint's axis, of all links behind it [N m]."""
    total = 0.0
    for i in range(joint, mass.shape[0]):
        rx = ry = rz = 0.0
        for k in range(3):
            rx += links[i + 1, 0, k] * com[i, k]
            ry += links[i + 1, 1, k] * com[i, k]
            rz += links[i + 1, 2, k] * com[i, k]
        rx += links[i + 1, 0, 3] - links[joint, 0, 3]
        ry += links[i + 1, 1, 3] - links[joint, 1, 3]
        rz += links[i + 1, 2, 3] - links[joint, 2, 3]
        fx, fy, fz = mass[i] * gravity[0], mass[i] * gravity[1], mass[i] * gravity[2]
        mx, my, mz = ry * fz - rz * fy, rz * fx - rx * fz, rx * fy - ry * fx
        total += links[joint, 0, 2] * mx + links[joint, 1, 2] * my + links[joint, 2, 2] * mz
    return total


@njit(cache=True, nogil=True)
def _tcp_poses_with_errors(
    a: Array,
    d: Array,
    alpha: Array,
    theta_offset: Array,
    mass: Array,
    com: Array,
    gravity: Array,
    T_flange_tcp: Array,
    kinds: Integers,
    joints: Integers,
    values: Array,
    qs: Array,
) -> Array:
    n = a.shape[0]
    a, d, alpha, zero, compliance = a.copy(), d.copy(), alpha.copy(), np.zeros(n), np.zeros(n)
    for p in range(kinds.shape[0]):
        j = joints[p]
        if kinds[p] == 0:
            a[j] += values[p]
        elif kinds[p] == 1:
            d[j] += values[p]
        elif kinds[p] == 2:
            alpha[j] += values[p]
        elif kinds[p] == 3:
            zero[j] += values[p]
        elif kinds[p] == 4:
            compliance[j] += values[p]
    links = np.zeros((n + 1, 4, 4))
    theta = np.zeros(n)
    Ts = np.zeros((qs.shape[0], 4, 4))
    for k in range(qs.shape[0]):
        for j in range(n):
            theta[j] = qs[k, j] + theta_offset[j] + zero[j]
        _compute_link_poses(a, d, alpha, theta, links)
        bent = False
        for j in range(n):
            if compliance[j] != 0.0:
                theta[j] += compliance[j] * _gravity_moment(links, j, mass, com, gravity)
                bent = True
        if bent:
            _compute_link_poses(a, d, alpha, theta, links)
        for r in range(4):
            for c in range(4):
                total = 0.0
                for m in range(4):
                    total += links[n, r, m] * T_flange_tcp[m, c]
                Ts[k, r, c] = total
    return Ts


def play_widths(model: ErrorModel, values: Array) -> Array:
    """Width of each joint's play (n,) [rad]."""
    widths = np.zeros(model.n_joints)
    chosen = model.parameter_kinds == ErrorKind.PLAY
    widths[model.parameter_joints[chosen]] = values[chosen]
    return widths


def tcp_poses_with_errors(model: ErrorModel, qs: Array, values: Array, sides: Array | None = None) -> Array:
    """T_base_tcp of joint vectors if the parameters were off by `values`.

    Model:   classic DH with a + da, d + dd, alpha + dalpha, theta + dtheta + compliance x moment of gravity at the
             undeflected posture; behind its play a joint stands at q - side x width / 2.
    Args:    qs: encoders (k, n) [rad]; values: (p,), SI, in the model's order; sides: where each joint rests in its
             play (k, n), -1 to 1 (`play.py`), the middle where absent.
    Returns: (k, 4, 4).
    Source:  Makinen et al. 2023, eq. 23-24, for the nominal part.
    """
    turned = qs if sides is None else qs - 0.5 * sides * play_widths(model, values)
    return _tcp_poses_with_errors(
        model.dh_a_m,
        model.dh_d_m,
        model.dh_alpha_rad,
        model.theta_offset,
        model.mass_kg,
        model.com_m,
        model.gravity_base,
        model.T_flange_tcp,
        model.parameter_kinds,
        model.parameter_joints,
        np.ascontiguousarray(values, dtype=np.float64),
        np.ascontiguousarray(turned, dtype=np.float64),
    )
