"""A plain scene with known numbers: for tests of vision that must not wait for a drawn world."""

from dataclasses import replace

import numpy as np

from machine.description import Machine
from machine.poses import inverse_pose, pose
from machine.rotations import Array, rotation_about
from sim_plc.world import CameraTruth, SceneTruth, StructureTruth


def demo_tcp_pose(machine: Machine, distance_m: float, offset_ooi_m: tuple[float, float] = (0.0, 0.0)) -> Array:
    """T_ooi_tcp with the tool facing the OOI squarely, `distance_m` in front of it; in `demo_world` also T_base_tcp."""
    T_ooi_tool = pose(np.eye(3), np.array([*offset_ooi_m, distance_m]))
    return T_ooi_tool @ inverse_pose(machine.T_tcp_tool)


_ELBOW_BASE_M = np.array([0.0, 1.2, 2.6])  # up and behind a tool that looks at the OOI
_DOWN_BASE = np.array([0.0, -1.0, 0.0])  # the base is the OOI's frame, y up


def _structure(cover_frac: float, contrast_frac: float, hoses_move: bool) -> StructureTruth:
    return StructureTruth(cover_frac, contrast_frac, hoses_move, _ELBOW_BASE_M, _DOWN_BASE)


def demo_world(
    machine: Machine,
    *,
    T_base_ooi: Array | None = None,
    noise_grey: float = 2.0,
    psf_px: float = 0.6,
    exposure_s: float = 0.0,
    readout_s: float = 0.0,
    wall_relief_m: float = 0.0,
    texture_contrast_frac: float = 1.0,
    texture_seed: int = 1,
    mount_tilt_deg: float = 0.0,
    structure_frac: float = 0.0,
    structure_contrast_frac: float = 1.0,
    hoses_move: bool = True,
) -> tuple[CameraTruth, SceneTruth]:
    """Camera and scene exactly as the machine file says, but for what the arguments change.

    Args:    machine: the nominal machine. T_base_ooi: pose of the OOI (4, 4), identity by default, so that a tool pose
             in the base is one in the OOI. mount_tilt_deg: true rotation of the mount about the camera's x axis.
             structure_frac: share of the picture that the crane's own structure covers, 0 to 0.4; 0: only the tool.
             structure_contrast_frac: of its texture, 0 is plain paint. hoses_move: else they rest in the picture.
    """
    tilt = pose(rotation_about("x", np.deg2rad(mount_tilt_deg)), np.zeros(3))
    camera = CameraTruth(
        left=replace(machine.camera),
        right=replace(machine.camera),
        T_tcp_cam_left=machine.T_tcp_cam_left @ tilt,
        clock_offset_s=0.0,
        latency_s=0.040,
        jitter_s=0.0,
        noise_grey=noise_grey,
        psf_px=psf_px,
        exposure_s=exposure_s,
        readout_s=readout_s,
    )
    scene = SceneTruth(
        T_base_ooi=np.eye(4) if T_base_ooi is None else T_base_ooi,
        ooi_markers=machine.markers_on("ooi"),
        tool_markers=machine.markers_on("tool"),
        T_tcp_tool=machine.T_tcp_tool,
        wall_offset_m=0.06,
        wall_relief_m=wall_relief_m,
        texture_contrast_frac=texture_contrast_frac,
        texture_seed=texture_seed,
        ooi_boards=tuple(board for board in machine.boards_on("ooi") if board.kind == "charuco"),
        structure=None if structure_frac == 0.0 else _structure(structure_frac, structure_contrast_frac, hoses_move),
    )
    return camera, scene
