"""Behind the encoders: where the links truly are, and what tracker, camera and a calibration at rest see of them.

Own forward kinematics on the plant's tree (springs included); effects as their definitions say. No diagnosis code.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.diagnosis.sealed import nominal_own as own
from benchmarks.diagnosis.sealed.faults import Faults
from benchmarks.diagnosis.sealed.filters import filtered_by
from benchmarks.diagnosis.sealed.own_plant import encoder_rows, true_at, truth
from machine.description import StereoCamera
from machine.rotations import Array, rotation_about, rotation_from_rotvec
from sim_plc.plant.statics import frames, static_equilibrium_angles
from sim_plc.plant.tree import MOTOR_JOINT_INDICES, N_TREE_JOINTS, Tree, build_tree
from sim_plc.plant.truth import KinematicTruth, PlantTruth

TILTED_STEP = (0, 1, 4)  # the tree's step that ends at slew, lift, tilt
POINT_BODY = {2: 3, 3: 6}  # the tree's body that carries link 2, link 3


@dataclass(frozen=True)
class Structure:
    """The true arm behind the joints: its tree, base rotation, extra static bending."""

    tree: Tree
    kinematics: KinematicTruth
    R_base: Array
    base_compliance: float
    sag: Array
    gravity: Array


def structure_of(faults: Faults, plant: PlantTruth | None = None) -> Structure:
    """With lengths, axis tilts, sag, base tilt and base compliance of the injected effects."""
    base = truth() if plant is None else plant
    a, d, sag = base.kinematics.a_m.copy(), base.kinematics.d_m.copy(), np.zeros(3)
    tilts: list[tuple[int, str, float]] = []
    R_base, compliance = np.eye(3), 0.0
    for one in faults.injected:
        if one.name == "link_length_error" and one.joint is not None:
            (d if one.option == "d" else a)[one.joint - 1] += one.size
        elif one.name == "gravity_sag" and one.joint is not None:
            sag[one.joint - 1] += one.size
        elif one.name == "joint_axis_tilt" and one.joint is not None:
            tilts.append((one.joint, one.option or "x", one.size))
        elif one.name == "base_tilt":
            R_base = rotation_from_rotvec(one.size * np.array(one.direction))
        elif one.name == "base_compliance":
            compliance = one.size
    kinematics = replace(base.kinematics, a_m=a, d_m=d)
    inertia = base.inertia
    kg = faults.of("payload_error")
    if kg:
        tip = own.six_joints().T_flange_tcp[:3, 3]
        mass, com = inertia.mass_kg.copy(), inertia.com_m.copy()
        com[5] = (mass[5] * com[5] + kg * tip) / (mass[5] + kg)
        mass[5] += kg
        inertia = replace(inertia, mass_kg=mass, com_m=com)
    tree = build_tree(kinematics, inertia)
    R = tree.tree_R.copy()
    for joint, axis, angle in tilts:  # the step ends in Rz(zero); the tilt belongs before that turn
        zero = rotation_about("z", float(base.kinematics.theta_zero_rad[joint - 1]))
        R[TILTED_STEP[joint - 1]] = R[TILTED_STEP[joint - 1]] @ zero.T @ rotation_about(axis, angle) @ zero
    return Structure(replace(tree, tree_R=R), kinematics, R_base, compliance, sag, base.inertia.gravity_base_m_s2)


def bodies_at(structure: Structure, tree_q: Array) -> tuple[Array, Array]:
    """Frames of the tree's bodies R (11, 3, 3), p (11, 3) in base, bent by sag and leaning base."""
    q = tree_q.copy()
    R, p = frames(structure.tree, q)
    com = p + np.einsum("nij,nj->ni", R, structure.tree.com_m)
    weight = structure.tree.mass_kg[:, None] * (structure.R_base.T @ structure.gravity)
    if structure.sag.any():
        for k in range(3):
            i = int(MOTOR_JOINT_INDICES[k])
            torque = float(R[i, :, 2] @ np.cross(com[i:] - p[i], weight[i:]).sum(axis=0))
            q[i] += structure.sag[k] * torque
        R, p = frames(structure.tree, q)
    turn = structure.R_base
    if structure.base_compliance:
        moment = structure.R_base @ np.cross(com, weight).sum(axis=0)
        turn = rotation_from_rotvec(structure.base_compliance * moment) @ turn
    return np.einsum("ij,njk->nik", turn, R), p @ turn.T


def link_frames(structure: Structure, R: Array, p: Array) -> dict[int, Array]:
    """T_base_link of links 2 and 3, and of the tcp (0), each (4, 4)."""
    k = structure.kinematics
    to_y, to_x = rotation_about("x", -np.pi / 2), rotation_about("y", np.pi / 2)
    out = {}
    for link, turned in ((2, to_y), (3, to_x)):
        body, i = POINT_BODY[link], link - 1
        T = np.eye(4)
        T[:3, :3] = turned.T @ rotation_about("x", float(k.alpha_rad[i]))
        T[:3, 3] = turned.T @ np.array([k.a_m[i], 0.0, k.d_m[i]])
        out[link] = _pose(R[body], p[body]) @ T
    out[0] = _pose(R[-1], p[-1]) @ structure.tree.T_last_tcp
    return out


def _pose(R: Array, p: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T


def points_at(structure: Structure, tree_q: Array) -> dict[str, Array]:
    """Every tracked point in base (3,) [m]."""
    links = link_frames(structure, *bodies_at(structure, tree_q))
    return {
        name: links[joint][:3, :3] @ np.array(xyz) + links[joint][:3, 3] for name, (joint, xyz) in own.POINTS.items()
    }


def swung(faults: Faults, tree_q: Array, motors: Sequence[int]) -> Array:
    """Tree angles (m, k), a row a PLC cycle, with the links' added swing behind their joints.

    Model: b'' + 2 zeta w b' + w^2 b = -gain q'', by the bilinear transform (the diagnosis steps it exactly, held).
    """
    out = tree_q
    for one in faults.injected:
        if one.name == "link_flexibility" and one.joint is not None:
            from scipy.signal import bilinear  # it takes two seconds to import

            w, zeta = 2.0 * np.pi * one.values["frequency_hz"], one.values["damping"]
            numerator, denominator = bilinear(
                [-one.size, 0.0, 0.0], [1.0, 2.0 * zeta * w, w * w], 1.0 / own.CYCLE_S
            )  # fmt: skip
            i = motors[one.joint - 1]
            out = out.copy()
            out[:, i] += filtered_by(numerator, denominator, tree_q[:, i] - tree_q[0, i])
    return out


def at_times(t: Array, tree_q: Array, when: Array) -> Array:
    """Tree angles at other times, linear."""
    return np.stack([np.interp(when, t, tree_q[:, i]) for i in range(tree_q.shape[1])], axis=1)


def rest_poses(faults: Faults, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Encoder readings (m, 3) and true tree angles (m, 11) of poses at rest; every third is visited twice."""
    half = np.array([0.9, 0.4, 0.5])
    low, high = own.HOME_RAD - half, own.HOME_RAD + half
    readings = rng.uniform(low, high, (count, 3))
    readings = np.concatenate([readings, readings[::3]])
    encoder, plant = encoder_rows(faults, 3), truth()
    structure = structure_of(faults)
    play = plant.kinematics.backlash_rad[:3].copy()
    for one in faults.injected:
        if one.name == "backlash" and one.joint is not None:
            play[one.joint - 1] += one.size
    out = np.zeros((len(readings), N_TREE_JOINTS))
    for k, reading in enumerate(readings):
        motors = np.concatenate([true_at(reading, encoder), own.WRIST_RAD])
        q = static_equilibrium_angles(structure.tree, structure.gravity, motors, plant.flex.stiffness_nm_rad)
        q[MOTOR_JOINT_INDICES[:3]] += 0.5 * play * rng.uniform(-1.0, 1.0, 3)
        out[k] = q
    return readings, out


@dataclass(frozen=True)
class Sight:
    """The true camera and its clock."""

    camera: StereoCamera
    T_tcp_cam: Array
    R_left_right: Array
    marker_scale: float
    late_s: float
    rate: float
    readout_s: float


def sight_of(faults: Faults) -> Sight:
    """With lens, mount, markers and clock of the injected effects."""
    camera, T = own.six_joints().camera, own.six_joints().T_tcp_cam_left.copy()
    values = {"R": np.eye(3), "marker": 1.0, "late": 0.0, "rate": 0.0, "readout": 0.0}
    for one in faults.injected:
        if one.name == "focal_length_error":
            camera = replace(camera, fx_px=camera.fx_px * (1 + one.size), fy_px=camera.fy_px * (1 + one.size))
        elif one.name == "principal_point_error":
            shift = one.size * np.array(one.direction)
            camera = replace(camera, cx_px=camera.cx_px + shift[0], cy_px=camera.cy_px + shift[1])
        elif one.name == "lens_distortion":
            camera = replace(camera, distortion=(camera.distortion[0] + one.size, *camera.distortion[1:]))
        elif one.name == "hand_eye_rotation":
            T[:3, :3] = T[:3, :3] @ rotation_from_rotvec(one.size * np.array(one.direction))
        elif one.name == "hand_eye_translation":
            T[:3, 3] += one.size * np.array(one.direction)
        elif one.name == "stereo_misalignment":
            values["R"] = rotation_from_rotvec(one.size * np.array(one.direction))
        elif one.name == "marker_size_error":
            values["marker"] = 1.0 + one.size
        elif one.name in ("clock_offset", "camera_latency"):
            values["late"] += one.size
        elif one.name == "clock_drift":
            values["rate"] = 1e-6 * one.size
        elif one.name == "rolling_shutter":
            values["readout"] = one.size
    return Sight(camera, T, values["R"], values["marker"], values["late"], values["rate"], values["readout"])


def corners(sight: Sight, T_base_cam: Array, T_base_object: Array, side: float, place: Array) -> Array:
    """Corners (2 eyes, 4, 2) [px] of one marker at `place` on its object; NaN behind an eye."""
    half = 0.5 * side * sight.marker_scale
    square = np.array([[-half, half, 0.0], [half, half, 0.0], [half, -half, 0.0], [-half, -half, 0.0]]) + place
    world = square @ T_base_object[:3, :3].T + T_base_object[:3, 3]
    left = (world - T_base_cam[:3, 3]) @ T_base_cam[:3, :3]
    right = (left - np.array([sight.camera.baseline_m, 0.0, 0.0])) @ sight.R_left_right
    return np.stack([_pixels(sight.camera, left), _pixels(sight.camera, right)])


def _pixels(camera: StereoCamera, points: Array) -> Array:
    if (points[:, 2] < 0.05).any():
        return np.full((len(points), 2), np.nan)
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    k1, k2, p1, p2, k3 = camera.distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = camera.fx_px * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + camera.cx_px
    v = camera.fy_px * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + camera.cy_px
    return np.stack([u, v], axis=1)
