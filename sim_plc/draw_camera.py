"""Draws the true camera: mount, lens, stereo residual, clock and image quality."""

from dataclasses import replace

import numpy as np

from machine.description import Machine
from machine.poses import pose
from machine.rotations import Array, rotation_from_rotvec
from sim_plc.presets import spread_of
from sim_plc.world import CameraTruth, rng_for

# The preset gives 5 deg about camera x without a sign. Positive turns the view up and puts the lower markers out of the
# image at the goal, where positioning could not be judged; negative looks down at the tool, as a person would hang it.
PAPER_MOUNT_AXIS_CAM = np.array([-1.0, 0.0, 0.0])


def random_axis(rng: np.random.Generator) -> Array:
    """Unit vector (3,), evenly on the sphere."""
    vector = rng.standard_normal(3)
    return vector / np.linalg.norm(vector)


def draw_mount(machine: Machine, preset: str, rng: np.random.Generator) -> Array:
    """True T_tcp_cam_left: the nominal mount turned and shifted."""
    axis = PAPER_MOUNT_AXIS_CAM if preset == "paper" else random_axis(rng)
    angle = np.deg2rad(spread_of(preset, "mount_angle").draw(rng)[0])
    shift = spread_of(preset, "mount_translation").draw(rng, 3)
    nominal = machine.T_tcp_cam_left
    return pose(nominal[:3, :3] @ rotation_from_rotvec(axis * angle), nominal[:3, 3] + shift)


def draw_camera(machine: Machine, preset: str, seed: int, T_tcp_cam_left: Array) -> CameraTruth:
    """The camera of one preset and seed on a given mount. The eyes share all lens residuals but the disparity bias."""

    def draw(name: str) -> float:
        return float(spread_of(preset, name).draw(rng_for(seed, name))[0])

    nominal = machine.camera
    scale = 1.0 + 1e-2 * draw("focal_length")
    centre = spread_of(preset, "principal_point").draw(rng_for(seed, "principal_point"), 2)
    left = replace(
        nominal,
        fx_px=nominal.fx_px * scale,
        fy_px=nominal.fy_px * scale,
        cx_px=nominal.cx_px + float(centre[0]),
        cy_px=nominal.cy_px + float(centre[1]),
        distortion=(nominal.distortion[0] + draw("k1"), *nominal.distortion[1:]),
    )
    return CameraTruth(
        left=left,
        right=replace(left, cx_px=left.cx_px + draw("disparity_bias")),
        T_tcp_cam_left=T_tcp_cam_left,
        clock_offset_s=draw("clock_offset"),
        latency_s=draw("latency"),
        jitter_s=draw("jitter"),
        noise_grey=draw("image_noise"),
        psf_px=draw("psf"),
        exposure_s=draw("exposure"),
        readout_s=draw("readout"),
    )
