"""Other starts of gtsam's stereo data."""

from dataclasses import replace

import numpy as np
from gtsam_stereo_data import StereoData

from machine.rotations import rotation_from_rotvec

START_ROTATION_RAD, START_POSITION_M, START_DEPTH_FRAC = 0.01, 0.1, 0.1


def disturbed_start(data: StereoData, seed: int) -> StereoData:
    """Another start: poses but the first off by 0.01 rad and 0.1 m, landmarks by 10 % of their distance (sigmas)."""
    rng = np.random.default_rng(seed)
    Ts = data.Ts_vo_cam.copy()
    for T in Ts[1:]:
        T[:3, :3] = rotation_from_rotvec(START_ROTATION_RAD * rng.normal(size=3)) @ T[:3, :3]
        T[:3, 3] += START_POSITION_M * rng.normal(size=3)
    _, first = np.unique(data.points, return_index=True)
    eyes = data.Ts_vo_cam[data.frames[first], :3, 3]
    stretch = np.exp(START_DEPTH_FRAC * rng.normal(size=(len(eyes), 1)))
    return replace(data, Ts_vo_cam=Ts, points_vo=eyes + stretch * (data.points_vo - eyes))
