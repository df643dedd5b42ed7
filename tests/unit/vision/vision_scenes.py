"""Scenes with known truth for the tests of vision: projected corners, and rendered pairs."""

from functools import lru_cache
from pathlib import Path

import numpy as np

from benchmarks.simulator.demo_scene import demo_tcp_pose, demo_world
from machine.camera import project_stereo
from machine.description import Machine, Marker, parse_machine_toml
from machine.markers import marker_corners
from machine.poses import inverse_pose, pose, transform_points
from machine.rotations import rotation_about, rotation_from_rotvec, rotvec_from_rotation
from server.vision.pose_problem import Sighting
from sim_plc.camera.renderer import RenderSetup, StereoRenderer

ROOT = Path(__file__).parents[3]
DATA = ROOT / ".." / "shared" / "data"
FACING = pose(rotation_about("x", np.pi), np.zeros(3))  # a marker that looks straight into the camera


@lru_cache
def machine() -> Machine:
    return parse_machine_toml((ROOT / "machine" / "machines" / "hiab033.toml").read_text(encoding="utf-8"))


@lru_cache(maxsize=2)
def renderer(contrast_frac: float = 1.0, noise_grey: float = 2.0) -> StereoRenderer:
    camera, scene = demo_world(
        machine(), noise_grey=noise_grey, wall_relief_m=0.02, texture_contrast_frac=contrast_frac
    )
    return StereoRenderer(RenderSetup(camera, scene))


def tcp_in_ooi(distance_m: float, offset_m: tuple[float, float] = (0.0, 0.0), tilt_deg: tuple = (0.0, 0.0, 0.0)):
    """T_ooi_tcp (= T_base_tcp in the demo world) with the tool in front of the OOI."""
    T = demo_tcp_pose(machine(), distance_m, offset_m)
    T[:3, :3] = rotation_from_rotvec(np.deg2rad(tilt_deg)) @ T[:3, :3]
    return T


def truth_of(T_ooi_tcp: np.ndarray) -> dict[str, np.ndarray]:
    """T_cam_tool and T_cam_ooi of the nominal mount."""
    T_cam_ooi = inverse_pose(T_ooi_tcp @ machine().T_tcp_cam_left)
    return {"ooi": T_cam_ooi, "tool": T_cam_ooi @ T_ooi_tcp @ machine().T_tcp_tool}


def facing_pose(distance_m: float, tilt_deg: float = 0.0, roll_deg: float = 0.0, lateral_m: tuple = (0.0, 0.0)):
    """T_cam_object: its z axis towards the camera, tilted about an axis in its plane that `roll_deg` turns."""
    turn = rotation_about("z", np.deg2rad(roll_deg))
    tilt = turn @ rotation_about("x", np.deg2rad(tilt_deg)) @ turn.T
    return pose(FACING[:3, :3] @ tilt, np.array([*lateral_m, distance_m]))


def sight(markers, T_cam_object, rng=None, sigma_px=0.0, eyes="lr") -> tuple[Sighting, ...]:
    """Exact (or noisy) sightings of markers of one object in raw pixels."""
    found = []
    for marker in markers:
        corners = transform_points(T_cam_object @ marker.T_on_marker, marker_corners(marker.side_m))
        both = project_stereo(machine().camera, corners)
        noisy = [pixels + (rng.normal(0.0, sigma_px, (4, 2)) if rng is not None else 0.0) for pixels in both]
        found.append(Sighting(marker, noisy[0] if "l" in eyes else None, noisy[1] if "r" in eyes else None))
    return tuple(found)


def single_marker(side_m: float, on="ooi") -> Marker:
    return Marker(marker_id=7, side_m=side_m, on=on, T_on_marker=np.eye(4))


def deviation(T_found: np.ndarray, T_true: np.ndarray) -> np.ndarray:
    """(6,): rotation vector [rad] by left perturbation, then translation [m]."""
    rotation = rotvec_from_rotation(T_found[:3, :3] @ T_true[:3, :3].T)
    return np.concatenate([rotation, T_found[:3, 3] - T_true[:3, 3]])
