"""One world per preset and seed: draws machine, camera, posture and wall; rejects scenes that cannot work."""

from dataclasses import replace

import numpy as np

from machine.camera import project
from machine.chain import Chain, chain_of
from machine.description import Machine, Marker, StereoCamera
from machine.inverse import InverseStatus, inverse_nearest
from machine.kinematics import tcp_pose
from machine.markers import marker_corners
from machine.poses import inverse_pose, pose, transform_points
from machine.rotations import Array
from machine.visibility import FACING_COSINE_MIN
from sim_plc.draw_camera import draw_camera, draw_mount
from sim_plc.draw_plant import draw_plant
from sim_plc.draw_scene import draw_posture, draw_scene, draw_start, draw_structure, draw_tool
from sim_plc.plant.plant import Plant
from sim_plc.presets import PresetError, checked_preset
from sim_plc.world import CameraTruth, SceneTruth, World, rng_for

STAND_OFF_M = 0.100  # of the goal the scene is judged by
JOINT_MARGIN_RAD = np.deg2rad(3.0)
THETA5_MIN_RAD = np.deg2rad(15.0)
START_THETA5_RAD = np.deg2rad([20.0, 90.0])
LOOK_ELEVATION_SINE_MAX = np.sin(np.deg2rad(20.0))
TOOL_HEIGHT_MIN_M = 0.4  # above the floor at the start
CALIBRATION_EXCURSION_M = 0.2  # sideways, for a calibration path
VIEW_MARGIN_START_PX, VIEW_MARGIN_GOAL_PX = 30.0, 10.0
WALL_CLEARANCE_M = 0.05
JOINT_STEP_MAX_RAD = np.deg2rad(30.0)  # between neighbouring poses: more means another branch
SCENE_DRAWS_MAX = 2000


def draw_world(machine: Machine, preset: str, seed: int) -> World:
    """The world of one preset and seed; the same arguments give the same world.

    Mount, tool marker, posture and start are drawn again in every attempt.
    Raises:  PresetError: no such preset, or no usable scene in SCENE_DRAWS_MAX draws.
    """
    checked_preset(preset)
    plant = draw_plant(machine, preset, seed)
    streams = {name: rng_for(seed, name) for name in ("posture", "start", "mount", "tool_marker")}
    refused: dict[str, int] = {}
    for _ in range(SCENE_DRAWS_MAX):
        q_start = draw_posture(machine, preset, streams["posture"])
        T_ooi_tool = draw_start(preset, streams["start"])
        T_tcp_cam_left = draw_mount(machine, preset, streams["mount"])
        T_tcp_tool = draw_tool(machine, preset, streams["tool_marker"])
        reason = posture_fault(machine, q_start)
        if reason is None and q_start is not None:
            T_base_tcp = Plant(plant, q_start).T_base_tcp()
            structure = draw_structure(machine, preset, seed, q_start)
            scene = draw_scene(machine, preset, seed, T_base_tcp, T_tcp_tool, T_ooi_tool, structure)
            camera = draw_camera(machine, preset, seed, T_tcp_cam_left)
            reason = scene_fault(machine, q_start, T_base_tcp, scene, camera)
            if reason is None:
                return World(machine, preset, seed, plant, camera, scene, q_start)
        refused[str(reason)] = refused.get(str(reason), 0) + 1
    raise PresetError(
        f"no usable scene in {SCENE_DRAWS_MAX} draws of preset '{preset}', seed {seed}; refused for {refused}"
    )


def posture_fault(machine: Machine, q_start: Array | None) -> str | None:
    """Why a start posture is unusable, or None: limits, wrist angle, look direction, height."""
    if q_start is None:
        return "reach"
    chain = _narrow_joint_limits(chain_of(machine))
    if np.any(q_start < chain.q_min) or np.any(q_start > chain.q_max):
        return "joint limits at the start"
    if not START_THETA5_RAD[0] <= abs(q_start[4]) <= START_THETA5_RAD[1]:
        return "wrist angle at the start"
    T_base_tcp = tcp_pose(chain, q_start)
    if abs(T_base_tcp[2, 2]) > LOOK_ELEVATION_SINE_MAX:
        return "tool not level"
    return "tool too low" if T_base_tcp[2, 3] < TOOL_HEIGHT_MIN_M else None


def scene_fault(
    machine: Machine, q_start: Array, T_base_tcp: Array, scene: SceneTruth, camera: CameraTruth
) -> str | None:
    """Why a scene is unusable, or None: reach and limits on the way, markers in view, clearance to the wall."""
    T_ooi_start = inverse_pose(scene.T_base_ooi) @ T_base_tcp @ scene.T_tcp_tool
    T_ooi_goal = pose(np.eye(3), np.array([0.0, 0.0, STAND_OFF_M]))
    if not all_in_view(camera, scene, T_ooi_start, VIEW_MARGIN_START_PX):
        return "view at the start"
    if not all_in_view(camera, scene, T_ooi_goal, VIEW_MARGIN_GOAL_PX):
        return "view at the goal"
    Ts_ooi_tool = tool_stations(T_ooi_start, T_ooi_goal)
    if wall_clearance(scene, Ts_ooi_tool) < WALL_CLEARANCE_M:
        return "wall"
    # What the nominal machine has to do: the same motion of the tool, seen from its own belief of the start.
    chain = chain_of(machine)
    T_nominal_true = tcp_pose(chain, q_start) @ inverse_pose(T_base_tcp)
    T_tool_tcp = inverse_pose(scene.T_tcp_tool)
    Ts_base_tcp = [T_nominal_true @ scene.T_base_ooi @ T_ooi_tool @ T_tool_tcp for T_ooi_tool in Ts_ooi_tool]
    return inverse_fault(_narrow_joint_limits(chain), Ts_base_tcp, q_start)


def tool_stations(T_ooi_start: Array, T_ooi_goal: Array) -> list[Array]:
    """Poses the tool must be able to take: start, turned upright, sideways for a calibration, and on to the goal."""
    upright = pose(T_ooi_goal[:3, :3], T_ooi_start[:3, 3])
    stations = [T_ooi_start]
    for base in (T_ooi_start, upright):
        for dx, dy in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)):
            sideways = base[:3, :3] @ np.array([dx * CALIBRATION_EXCURSION_M, dy * CALIBRATION_EXCURSION_M, 0.0])
            stations.append(pose(base[:3, :3], base[:3, 3] + sideways))
            stations.append(base)
    for share in np.linspace(0.2, 1.0, 5):
        stations.append(pose(T_ooi_goal[:3, :3], (1.0 - share) * upright[:3, 3] + share * T_ooi_goal[:3, 3]))
    return stations


def inverse_fault(chain: Chain, Ts_base_tcp: list[Array], q_start: Array) -> str | None:
    """Why a sequence of nominal poses cannot be followed inside the chain's limits, or None."""
    q = q_start
    for T_base_tcp in Ts_base_tcp:
        found = inverse_nearest(chain, T_base_tcp, q)
        if found.status is not InverseStatus.OK or found.q_rad is None:
            return f"inverse: {found.status.value}"
        if abs(found.q_rad[4]) < THETA5_MIN_RAD:
            return "wrist singularity"
        if np.max(np.abs(found.q_rad - q)) > JOINT_STEP_MAX_RAD:
            return "branch change"
        q = found.q_rad
    return None


def wall_clearance(scene: SceneTruth, Ts_ooi_tool: list[Array]) -> float:
    """Smallest distance [m] of the tool tip to the wall's highest relief over a list of poses."""
    T_tool_tcp = inverse_pose(scene.T_tcp_tool)
    heights = [float((T_ooi_tool @ T_tool_tcp)[2, 3]) for T_ooi_tool in Ts_ooi_tool]
    return min(heights) + scene.wall_offset_m - 0.5 * scene.wall_relief_m


def all_in_view(camera: CameraTruth, scene: SceneTruth, T_ooi_tool: Array, margin_px: float) -> bool:
    """Whether both true eyes see the three OOI markers and the tool marker whole, inside a margin, from the front."""
    T_left_tool = inverse_pose(camera.T_tcp_cam_left) @ scene.T_tcp_tool
    T_left_ooi = T_left_tool @ inverse_pose(T_ooi_tool)
    shift = np.eye(4)
    shift[0, 3] = -camera.left.baseline_m
    for eye, T_eye_left in ((camera.left, np.eye(4)), (camera.right, shift)):
        on_wall = [_is_marker_visible(eye, T_eye_left @ T_left_ooi, marker, margin_px) for marker in scene.ooi_markers]
        on_tool = [
            _is_marker_visible(eye, T_eye_left @ T_left_tool, marker, margin_px) for marker in scene.tool_markers
        ]
        if not all(on_wall + on_tool):
            return False
    return True


def _is_marker_visible(eye: StereoCamera, T_eye_object: Array, marker: Marker, margin_px: float) -> bool:
    T_eye_marker = T_eye_object @ marker.T_on_marker
    centre = T_eye_marker[:3, 3]
    if centre[2] <= 0.05 or -T_eye_marker[:3, 2] @ centre / np.linalg.norm(centre) < FACING_COSINE_MIN:
        return False
    pixels = project(eye, transform_points(T_eye_marker, marker_corners(marker.side_m)))
    last = np.array([eye.width_px - 1.0 - margin_px, eye.height_px - 1.0 - margin_px])
    return bool(np.all(pixels >= margin_px) and np.all(pixels <= last))


def _narrow_joint_limits(chain: Chain) -> Chain:
    return replace(chain, q_min=chain.q_min + JOINT_MARGIN_RAD, q_max=chain.q_max - JOINT_MARGIN_RAD)
