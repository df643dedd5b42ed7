"""The nominal machine of the own plant: slew, lift and tilt of the HIAB-like crane, its wrist clamped."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from machine.chain import chain_of
from machine.description import Joint, Machine, parse_machine_toml
from machine.kinematics import tcp_pose
from machine.rotations import Array

N = 3
WRIST_RAD = np.deg2rad([0.0, -50.0, 0.0])  # clamped
HOME_RAD = np.deg2rad([0.0, 45.0, -95.0])  # the middle of the working postures
CYCLE_S = 0.005  # of the PLC; every cycle is logged
SENT_S = 0.01
DELAY_S = 0.01
SENT_EARLY_S = 0.0025  # sent between two PLC cycles, so that a jitter of half a cycle moves no arrival into another
POINTS = {"elbow": (2, (-0.25, 0.12, 0.05)), "tip": (3, (0.10, 0.0, 1.90)), "side": (3, (-0.05, 0.35, 1.20))}
OOI_AHEAD_M = 2.6  # of the camera at home
SIDE_M = 0.30
PLACES = ((1, -0.45, 0.30, 0.0), (2, 0.45, 0.28, -0.25), (3, 0.02, -0.35, -0.12))  # id, x, y, z on the object [m]
TOOL_SIDE_M = 0.10

Xyz = tuple[float, float, float]
Bodies = Sequence[tuple[float, Array]]


@cache
def six_joints() -> Machine:
    """The whole machine that the fine plant is sized for."""
    file = Path(__file__).parents[3] / "machine" / "machines" / "hiab033.toml"
    return parse_machine_toml(file.read_text(encoding="utf-8"))


def dh(joint: Joint, q: float) -> Array:
    """Classic DH transform Rz(theta) Tz(d) Tx(a) Rx(alpha)."""
    c, s = np.cos(q + joint.theta_offset_rad), np.sin(q + joint.theta_offset_rad)
    ca, sa = np.cos(joint.alpha_rad), np.sin(joint.alpha_rad)
    return np.array(
        [
            [c, -s * ca, s * sa, joint.a_m * c],
            [s, c * ca, -c * sa, joint.a_m * s],
            [0.0, sa, ca, joint.d_m],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def _clamped() -> tuple[Array, float, Array]:
    """T_link3_tcp (4, 4), mass [kg] and centre of mass (3,) of everything behind tilt, in link 3's frame."""
    machine, T = six_joints(), np.eye(4)
    tilt = machine.joints[2]
    mass, moment = tilt.mass_kg, tilt.mass_kg * np.array(tilt.com_m)
    for joint, q in zip(machine.joints[3:], WRIST_RAD, strict=True):
        T = T @ dh(joint, float(q))
        mass += joint.mass_kg
        moment = moment + joint.mass_kg * (T[:3, :3] @ np.array(joint.com_m) + T[:3, 3])
    return T @ machine.T_flange_tcp, mass, moment / mass


def T_base_ooi() -> Array:
    """Where the object stands: in front of the camera at home, its z towards the camera."""
    machine = six_joints()
    T_cam = tcp_pose(chain_of(machine), np.concatenate([HOME_RAD, WRIST_RAD])) @ machine.T_tcp_cam_left
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[2, 3] = OOI_AHEAD_M
    return T_cam @ T


def toml() -> str:
    """machine.toml of the nominal three-joint machine."""
    machine = six_joints()
    T_link_tcp, mass, com = _clamped()
    bodies = [(joint.mass_kg, np.array(joint.com_m)) for joint in machine.joints[: N - 1]] + [(mass, com)]
    return text_of("benchmark crane", machine.joints[:N], bodies, T_link_tcp, POINTS)


def text_of(
    name: str, joints: Sequence[Joint], bodies: Bodies, T_flange_tcp: Array, points: dict[str, tuple[int, Xyz]]
) -> str:
    """machine.toml of a three-joint machine with this benchmark's camera, markers and PLC.

    Args: bodies: mass [kg] and centre of mass (3,) in the link's frame, of each joint.
    """
    machine = six_joints()
    text = f'[machine]\nname = "{name}"\ngravity_base_m_s2 = [0.0, 0.0, -9.81]\n'
    for joint, (mass, com) in zip(joints, bodies, strict=True):
        text += _joint(joint, float(mass), com)
    camera = machine.camera
    text += (
        f"\n[tool]\nT_flange_tcp = {_row(T_flange_tcp)}\nT_tcp_tool = {_row(machine.T_tcp_tool)}\n"
        f"\n[camera]\nwidth_px = {camera.width_px}\nheight_px = {camera.height_px}\nfx_px = {camera.fx_px}\n"
        f"fy_px = {camera.fy_px}\ncx_px = {camera.cx_px}\ncy_px = {camera.cy_px}\n"
        f"distortion = {list(camera.distortion)}\nbaseline_m = {camera.baseline_m}\nrate_hz = 30.0\n"
        f"rectified = false\nT_tcp_cam_left = {_row(machine.T_tcp_cam_left)}\n"
        '\n[markers]\ndictionary = "DICT_4X4_50"\n'
    )
    text += _marker(10, TOOL_SIDE_M, "tool", 0.0, 0.0, 0.0)
    for number, x, y, z in PLACES:
        text += _marker(number, SIDE_M, "ooi", x, y, z)
    text += "\n[points]\n"
    for point, (joint, xyz) in points.items():
        text += f"{point} = {{ joint = {joint}, xyz_m = {list(xyz)} }}\n"
    text += f"\n[tracker]\nT_base_tracker = {_row(np.eye(4))}\n"
    return text + f"\n[plc]\ncycle_s = {CYCLE_S}\nlog_cycle_s = {CYCLE_S}\ntransport_delay_s = {DELAY_S}\n"


def _joint(joint: Joint, mass: float, com: Array) -> str:
    deg = np.rad2deg
    return (
        f'\n[[joint]]\nname = "{joint.name}"\ntype = "revolute"\ndh_convention = "classic"\n'
        f"a_m = {joint.a_m}\nd_m = {joint.d_m}\nalpha_deg = {deg(joint.alpha_rad):.12g}\n"
        f"theta_offset_deg = {deg(joint.theta_offset_rad):.12g}\nq_min_deg = {deg(joint.q_min_rad):.12g}\n"
        f"q_max_deg = {deg(joint.q_max_rad):.12g}\nqd_max_deg_s = {deg(joint.qd_max_rad_s):.12g}\n"
        f"qdd_max_deg_s2 = {deg(joint.qdd_max_rad_s2):.12g}\nvelocity_gain_rad_s = {joint.velocity_gain_rad_s}\n"
        f"valve_frequency_hz = {joint.valve_frequency_hz}\nvalve_damping = {joint.valve_damping}\n"
        f"kp_frac_per_rad = {joint.kp_frac_per_rad}\npt1_tau_s = {joint.pt1_tau_s}\nmass_kg = {mass!r}\n"
        f"com_m = {[float(x) for x in com]}\nencoder_counts_rev = {joint.encoder_counts_rev}\n"
    )


def _marker(number: int, side: float, on: str, x: float, y: float, z: float) -> str:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return f'\n[[markers.marker]]\nid = {number}\nside_m = {side}\non = "{on}"\nT_on_marker = {_row(T)}\n'


def _row(T: Array) -> str:
    return "[" + ", ".join(repr(float(x)) for x in np.asarray(T).ravel()) + "]"


def T_tcp_marker_tool() -> Array:
    """T_tcp_tool of the nominal file."""
    return six_joints().T_tcp_tool
