"""Printed targets before a plain wall, ray cast with the true lens: for tests of boards, dictionaries and teaching."""

from functools import lru_cache

import numpy as np
from vision_scenes import machine

from machine import targets
from machine.description import StereoCamera
from machine.poses import inverse_pose, pose
from sim_plc.camera.boards import Board, chess_board, marker_board, paint_board
from sim_plc.camera.eye import EyeRays, eye_rays
from sim_plc.camera.sensor import add_noise, noise_bank, point_spread

WALL_GREY = 120


@lru_cache(maxsize=2)
def rays(camera: StereoCamera) -> EyeRays:
    return eye_rays(camera)


@lru_cache(maxsize=1)
def bank() -> np.ndarray:
    return noise_bank(np.random.default_rng(3))


def printed(dictionary: str, *things: targets.Marker | targets.Board) -> list[Board]:
    """Things as they hang on an object, in its axes."""
    return [
        (marker_board if isinstance(thing, targets.Marker) else chess_board)(dictionary, thing, np.eye(4))
        for thing in things
    ]


def photographed(
    boards, T_cam_object, rng, noise_grey=2.0, psf_px=0.6, camera=None, supersample=4
) -> tuple[np.ndarray, np.ndarray]:
    """A raw stereo pair of boards in one object's axes."""
    lens = camera or machine().camera
    pair = []
    for x_m in (0.0, lens.baseline_m):
        T_object_eye = inverse_pose(T_cam_object) @ pose(np.eye(3), np.array([x_m, 0.0, 0.0]))
        keys = np.repeat(T_object_eye[None], 2, axis=0)
        image = np.full((lens.height_px, lens.width_px), WALL_GREY, np.uint8)
        for board in boards:
            paint_board(image, rays(lens), board, keys, supersample)
        image = np.ascontiguousarray(point_spread(image, psf_px))
        add_noise(image, bank(), noise_grey, rng)
        pair.append(image)
    return pair[0], pair[1]
