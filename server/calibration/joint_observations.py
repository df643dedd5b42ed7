"""Input of the joint estimate: odometry runs and looks, each with the joints at the time."""

from dataclasses import dataclass, replace

import numpy as np

from machine.poses import inverse_pose, pose_difference
from server.calibration.chords import arc_lengths
from server.calibration.contracts import Array, CameraTrack
from server.calibration.hand_eye_fit import rotation_vectors
from server.calibration.joint_lens import N_LENS
from server.calibration.joint_state import JointState
from server.calibration.kinematic_errors import ErrorModel, play_widths, tcp_poses_with_errors
from server.calibration.lens_evidence import LensEvidence


@dataclass(frozen=True, slots=True)
class JointTrack:
    """Encoders: times (m,) [s, PLC clock mapped to the PC], `qs` (m, n) [rad], `backlash_sides` (m, n) or None."""

    t_s: Array
    qs: Array
    backlash_sides: Array | None = None

    def joints_at(self, t_s: Array) -> tuple[Array, Array | None]:
        """Joints and their sides at these times (k, n), linear between samples."""
        qs = self._interpolate_columns(t_s, self.qs)
        return qs, None if self.backlash_sides is None else self._interpolate_columns(t_s, self.backlash_sides)

    def _interpolate_columns(self, t_s: Array, values: Array) -> Array:
        return np.column_stack([np.interp(t_s, self.t_s, column) for column in values.T])


@dataclass(frozen=True, slots=True)
class OdometryRun:
    """One path: the camera's own trajectory, and the encoders during it."""

    camera_track: CameraTrack
    joint_track: JointTrack


@dataclass(frozen=True, slots=True)
class LookAt:
    """One look at rest: joints (n,) [rad], marker poses in the camera and their covariances (6, 6), camera axes.

    `backlash_sides` (n,): where each joint rests in its play, or None.
    """

    q: Array
    T_cam_tool: Array
    T_cam_ooi: Array
    tool_covariance: Array
    ooi_covariance: Array
    backlash_sides: Array | None = None
    lens_evidence: LensEvidence | None = None  # of its corners on lens and prints


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """What the observations are worth, beyond their own covariances. Standard deviations."""

    sigma_position_m: float = 4e-4  # of one odometry position: first guess, refined by the path (sway of the boom)
    sigma_position_range_m: tuple[float, float] = (1e-4, 1.2e-3)  # what it is believed within
    sigma_turn_rad: float = float(np.deg2rad(0.04))  # of one odometry rotation
    sigma_affine_frac: float = 0.0005  # smooth distortion of the odometry's space beyond the lens unknowns'
    sigma_drift_frac: float = 0.0002  # random walk of the odometry, at one metre of path
    sigma_joint_rad: tuple[float, ...] = (1.5e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4)  # at rest: trims end about there
    sigma_look_turn_rad: float = float(np.deg2rad(0.01))  # of a marker pose, beyond lens unknowns and layout
    sigma_look_frac: float = 0.0002  # of its distance
    neighbours_range: tuple[float, float] = (-0.5, 0.8)  # correlation of neighbouring samples is believed within
    samples_max: int = 60
    sample_spacing_m: float = 0.015


@dataclass(frozen=True, slots=True)
class RunSamples:
    """One run thinned out: times (k,), measured camera poses relative to the first one (k, 4, 4), path length (k,)."""

    t_s: Array
    Ts_first_cam: Array
    length_m: Array


def thin_samples(run: OdometryRun, noise: NoiseModel) -> RunSamples:
    """Samples about evenly spaced along the path, the first one included."""
    positions = run.camera_track.Ts_vo_cam[:, :3, 3]
    length = arc_lengths(positions)
    spacing = max(noise.sample_spacing_m, float(length[-1]) / noise.samples_max)
    wanted = np.arange(0.0, float(length[-1]) + 1e-9, spacing)
    index = np.unique(np.searchsorted(length, wanted).clip(0, len(length) - 1))
    first = run.camera_track.Ts_vo_cam[index[0]]
    relative = inverse_pose(first) @ run.camera_track.Ts_vo_cam[index]
    return RunSamples(run.camera_track.t_s[index], relative, length[index])


@dataclass(frozen=True, slots=True)
class Scatter:
    """How a run's positions scatter: one sigma [m], and the correlation of neighbouring samples (-1 to 1).

    A boom that sways faster than it is sampled gives a negative one, slow bends of the odometry a positive one.
    """

    sigma_m: float
    neighbour_correlation: float = 0.0


def run_covariance(samples: RunSamples, noise: NoiseModel, scatter: Scatter) -> Array:
    """Covariance of a run's positions relative to the first one, (k - 1, k - 1), the same for each axis [m^2].

    Model:   scatter of the samples, first-order autoregressive; of the first one, which is taken at rest, the least
             scatter there is; a random walk along the path; and the effect of nine independent entries of a small
             linear distortion, sigma^2 (p_i . p_j).
    """
    p, length = samples.Ts_first_cam[1:, :3, 3], samples.length_m[1:]
    apart = np.abs(np.subtract.outer(np.arange(len(p)), np.arange(len(p))))
    own = scatter.sigma_m**2 * scatter.neighbour_correlation**apart + noise.sigma_position_range_m[0] ** 2
    walk = noise.sigma_drift_frac**2 * np.minimum.outer(length, length)
    return own + walk + noise.sigma_affine_frac**2 * (p @ p.T)


def run_residuals(
    model: ErrorModel, state: JointState, run: OdometryRun, samples: RunSamples, bending: Array
) -> tuple[Array, Array]:
    """Expected less measured: positions (k - 1, 3) [m] in the first camera's axes, rotation vectors (k - 1, 3).

    bending (7, 3, 3): what each lens unknown adds to a step (`joint_lens.odometry_sensitivity`).
    """
    qs, sides = run.joint_track.joints_at(samples.t_s + state.time_offset_s)
    Ts_base_cam = tcp_poses_with_errors(model, qs, state.kinematic_errors, sides) @ state.T_tcp_cam
    R_first, p_first = Ts_base_cam[0, :3, :3], Ts_base_cam[0, :3, 3]
    p = (Ts_base_cam[1:, :3, 3] - p_first) @ R_first
    R = R_first.T @ Ts_base_cam[1:, :3, :3]
    measured = samples.Ts_first_cam[1:]
    turns = rotation_vectors(R @ np.swapaxes(measured[:, :3, :3], 1, 2))
    bent = p @ np.tensordot(state.lens_corrections, bending, axes=1).T
    return state.odometry_scale * p + bent - measured[:, :3, 3], turns


def look_residual(model: ErrorModel, state: JointState, look: LookAt, sensitivity: Array) -> Array:
    """Expected less measured (12,): tool, then OOI; rotation vector [rad], then position [m], camera axes.

    sensitivity (12, 7): to the lens unknowns (`joint_lens.look_sensitivity`).
    """
    sides = None if look.backlash_sides is None else look.backlash_sides[None]
    T_base_tcp = tcp_poses_with_errors(model, look.q[None], state.kinematic_errors, sides)[0]
    T_cam_tool = inverse_pose(state.T_tcp_cam) @ state.T_tcp_tool
    T_cam_ooi = inverse_pose(T_base_tcp @ state.T_tcp_cam) @ state.T_base_ooi
    tool, ooi = pose_difference(look.T_cam_tool, T_cam_tool), pose_difference(look.T_cam_ooi, T_cam_ooi)
    return np.concatenate([tool, ooi]) + sensitivity @ state.lens_corrections


def look_covariance(model: ErrorModel, state: JointState, look: LookAt, noise: NoiseModel) -> Array:
    """Covariance (12, 12) of a look's residual: markers, what the lens unknowns leave, play of the joints."""
    C = np.zeros((12, 12))
    for at, covariance, T in ((0, look.tool_covariance, look.T_cam_tool), (6, look.ooi_covariance, look.T_cam_ooi)):
        turn, shift = noise.sigma_look_turn_rad, noise.sigma_look_frac * float(np.linalg.norm(T[:3, 3]))
        C[at : at + 6, at : at + 6] = covariance + np.diag(np.square([turn] * 3 + [shift] * 3))
    step = 1e-5
    no_lens = np.zeros((12, N_LENS))
    base = look_residual(model, state, look, no_lens)
    columns = []
    for j in range(model.n_joints):
        q = look.q.copy()
        q[j] += step
        shifted = replace(look, q=q)
        columns.append((look_residual(model, state, shifted, no_lens) - base) / step)
    J = np.column_stack(columns)
    sigma = _sigma_joints(model, look, noise)
    return C + (J * sigma**2) @ J.T


def _sigma_joints(model: ErrorModel, look: LookAt, noise: NoiseModel) -> Array:
    """One sigma of where each joint's output stands (n,) [rad]: at rest, and anywhere in its play if that is not known.

    Model:   a joint on side s of its play w may still be anywhere within (1 - |s|) w / 2 of there, evenly.
    """
    rest = np.resize(np.array(noise.sigma_joint_rad), model.n_joints)
    side = np.zeros(model.n_joints) if look.backlash_sides is None else look.backlash_sides
    return np.hypot(rest, (1.0 - np.abs(side)) * 0.5 * play_widths(model, model.prior_mean) / np.sqrt(3.0))
