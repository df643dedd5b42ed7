"""The bench's own machines: their nominal files, and kinematics, gravity and lens written from the contract alone."""

from dataclasses import dataclass

import numpy as np

from machine.rotations import Array

CYCLE_S, LOG_S, DELAY_S = 0.005, 0.005, 0.010
GRAVITY = 9.81
WIDTH, HEIGHT, FOCAL, BASELINE = 1280, 960, 800.0, 0.12
SIDE_M = 0.3
P_TCP_CAM = np.array([0.05, -0.08, 0.02])
ACTUATORS = np.array([[0.5, 8.0, 0.8, 6.0], [0.4, 10.0, 0.8, 7.0], [0.3, 9.0, 0.8, 6.0], [0.8, 12.0, 0.8, 6.0]])


@dataclass(frozen=True)
class Link:
    """One joint and its link: classic DH [m, deg], its range [deg, cm if sliding], its mass in the link's frame."""

    name: str
    a: float
    d: float
    alpha_deg: float
    theta_deg: float
    low_deg: float
    high_deg: float
    mass: float
    com: tuple[float, float, float]
    sliding: bool = False


SLEW = Link("slew", 0.0, 0.8, 90.0, 0.0, -120.0, 120.0, 300.0, (0.0, 0.0, 0.0))
BOOM = Link("boom", 2.5, 0.0, 0.0, 0.0, -30.0, 80.0, 200.0, (-1.2, 0.0, 0.0))
TELESCOPE_ARM = (
    SLEW,
    Link("boom", 0.0, 0.0, 90.0, 90.0, -30.0, 60.0, 200.0, (0.0, 0.0, 1.2)),
    Link("telescope", 0.0, 2.0, -90.0, 0.0, 0.0, 80.0, 60.0, (0.0, 0.5, 0.0), True),
    Link("pitch", 0.06, 0.0, 90.0, 0.0, -60.0, 60.0, 10.0, (0.0, 0.0, 0.0)),
    Link("roll", 0.0, 0.3, 0.0, 0.0, -150.0, 150.0, 8.0, (0.0, 0.0, 0.0)),
)
JIB = Link("jib", 1.6, 0.0, 0.0, 0.0, -110.0, 0.0, 80.0, (-0.8, 0.0, 0.0))
BOOM_ARM = (SLEW, BOOM)
CRANE_ARM = (SLEW, BOOM, JIB)


@dataclass(frozen=True)
class Truth:
    """What is wrong with a machine; nothing by default. Joints count from 1."""

    name: str = ""
    joint: int | None = None
    size: float = 0.0
    axis: tuple[float, float, float] = (1.0, 0.0, 0.0)

    def of(self, name: str, joint: int | None = None) -> float:
        """The size of an effect here; 0 if it is another one."""
        return self.size if (self.name, self.joint) == (name, joint) else 0.0


def frames(links: tuple[Link, ...], q: Array) -> list[Array]:
    """Poses of base and links (n + 1 of (4, 4)): turn and slide about z, then a along x and the twist."""
    T, out = np.eye(4), [np.eye(4)]
    for link, x in zip(links, q, strict=True):
        turn = np.deg2rad(link.theta_deg) + (0.0 if link.sliding else x)
        slide = link.d + (x if link.sliding else 0.0)
        T = T @ _screw(2, turn, slide) @ _screw(0, np.deg2rad(link.alpha_deg), link.a)
        out.append(T)
    return out


def _screw(axis: int, angle: float, along: float) -> Array:
    """A turn about and a shift along x (0) or z (2)."""
    T = np.eye(4)
    i, k = ((1, 2), (0, 1))[axis // 2]
    T[i, i] = T[k, k] = np.cos(angle)
    T[k, i], T[i, k] = np.sin(angle), -np.sin(angle)
    T[axis, 3] = along
    return T


def torque(links: tuple[Link, ...], q: Array, joint: int) -> float:
    """Gravity's torque about a joint's axis [N m], positive where it drives the joint forward."""
    T = frames(links, q)
    axis, at = T[joint - 1][:3, 2], T[joint - 1][:3, 3]
    total = 0.0
    for link, pose in zip(links[joint - 1 :], T[joint:], strict=True):
        lever = pose[:3, :3] @ np.array(link.com) + pose[:3, 3] - at
        total += float(np.cross(lever, [0.0, 0.0, -link.mass * GRAVITY]) @ axis)
    return total


def true_angles(links: tuple[Link, ...], encoder: Array, truth: Truth) -> Array:
    """Where the links are at rest behind encoder readings (n,): bias, then bending under gravity."""
    q = encoder - np.array([truth.of("encoder_bias", j) for j in range(1, len(links) + 1)])
    bent = np.array(
        [
            truth.of("gravity_sag", j) * torque(links, q, j) if truth.of("gravity_sag", j) else 0.0
            for j in range(1, len(links) + 1)
        ]
    )
    return q + bent


def turned(axis: Array, angle: float) -> Array:
    """Rotation (3, 3) about a unit axis (Rodrigues 1840)."""
    K = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


def corners(T_base_tcp: Array, T_base_marker: Array, truth: Truth) -> Array:
    """Corners (2 eyes, 4, 2) [px] of the marker: true mount, true focal length, true print."""
    mount = np.eye(4)
    mount[:3, :3] = turned(np.array(truth.axis), truth.of("hand_eye_rotation"))
    mount[:3, 3] = P_TCP_CAM
    T = np.linalg.inv(T_base_tcp @ mount) @ T_base_marker
    half = 0.5 * SIDE_M * (1.0 + truth.of("marker_size_error"))
    square = half * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
    points = square @ T[:3, :3].T + T[:3, 3]
    eyes = []
    for shift in (0.0, BASELINE):
        at = points - np.array([shift, 0.0, 0.0])
        pixels = at[:, :2] / at[:, 2:] * FOCAL * (1.0 + truth.of("focal_length_error"))
        eyes.append(pixels + np.array([WIDTH / 2.0, HEIGHT / 2.0]) if (at[:, 2] > 0.1).all() else at[:, :2] * np.nan)
    return np.array(eyes)


def machine_toml(links: tuple[Link, ...], driven: bool) -> str:
    """The nominal file; `driven`: with valves and controllers."""
    text = '[machine]\nname = "bench arm"\ngravity_base_m_s2 = [0.0, 0.0, -9.81]\n'
    for k, link in enumerate(links):
        low, high = (float(np.rad2deg(0.01 * x)) if link.sliding else x for x in (link.low_deg, link.high_deg))
        text += (
            f'\n[[joint]]\nname = "{link.name}"\ntype = "{"prismatic" if link.sliding else "revolute"}"\n'
            f'dh_convention = "classic"\na_m = {link.a}\nd_m = {link.d}\nalpha_deg = {link.alpha_deg}\n'
            f"theta_offset_deg = {link.theta_deg}\nq_min_deg = {low!r}\nq_max_deg = {high!r}\n"
            f"mass_kg = {link.mass}\ncom_m = {list(link.com)}\n"
        )
        if driven:
            gain, hz, zeta, kp = ACTUATORS[min(k, len(ACTUATORS) - 1)].tolist()
            text += (
                f"velocity_gain_rad_s = {gain}\nvalve_frequency_hz = {hz}\nvalve_damping = {zeta}\n"
                f"kp_frac_per_rad = {kp}\npt1_tau_s = 0.0\n"
            )
    mount = np.eye(4)
    mount[:3, 3] = P_TCP_CAM
    tip = [0.0, 0.0, 0.0]
    return text + (
        f"\n[tool]\nT_flange_tcp = {_row(np.eye(4))}\n"
        f"\n[camera]\nwidth_px = {WIDTH}\nheight_px = {HEIGHT}\nfx_px = {FOCAL}\nfy_px = {FOCAL}\ncx_px = {WIDTH / 2}\n"
        f"cy_px = {HEIGHT / 2}\ndistortion = [0.0, 0.0, 0.0, 0.0, 0.0]\nbaseline_m = {BASELINE}\nrate_hz = 10.0\n"
        f"rectified = true\nT_tcp_cam_left = {_row(mount)}\n"
        f'\n[markers]\ndictionary = "DICT_4X4_50"\n\n[[markers.marker]]\nid = 0\nside_m = {SIDE_M}\non = "ooi"\n'
        f"T_on_marker = {_row(np.eye(4))}\n\n[points]\ntip = {{ joint = {len(links)}, xyz_m = {tip} }}\n"
        f"\n[tracker]\nT_base_tracker = {_row(np.eye(4))}\n"
        f"\n[plc]\ncycle_s = {CYCLE_S}\nlog_cycle_s = {LOG_S}\ntransport_delay_s = {DELAY_S}\n"
    )


def _row(T: Array) -> str:
    return "[" + ", ".join(repr(float(x)) for x in T.ravel()) + "]"
