"""Resolved-rate tracking follows a path, and stays bounded where the wrist is singular."""

from importlib.resources import files

import numpy as np
import pytest

from machine.chain import chain_of
from machine.description import parse_machine_toml
from machine.errors import MachineError
from machine.kinematics import tcp_pose
from machine.poses import pose
from machine.tracking import track_path

CHAIN = chain_of(parse_machine_toml((files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8")))


def straight(q, shift, n=200):
    T = tcp_pose(CHAIN, q)
    return np.array([pose(T[:3, :3], T[:3, 3] + s * np.array(shift)) for s in np.linspace(0.0, 1.0, n)])


def test_follows_a_straight_line_to_a_tenth_of_a_millimetre():
    q = np.deg2rad([10.0, 40.0, -80.0, 5.0, -40.0, 3.0])
    tracked = track_path(CHAIN, q, straight(q, [0.2, 0.1, -0.1]), 0.01)
    assert tracked.position_error_max_m < 1e-4
    assert tracked.rotation_error_max_rad < 1e-4
    assert tracked.sigma_min.min() > 0.1


def test_stays_bounded_through_the_wrist_singularity():
    q = np.deg2rad([0.0, 40.0, -60.0, 0.0, 2.0, 0.0])
    T = tcp_pose(CHAIN, q)
    T_end = tcp_pose(CHAIN, np.deg2rad([0.0, 40.0, -60.0, 0.0, -2.0, 0.0]))
    path = np.array([pose(T[:3, :3], T[:3, 3] + s * (T_end[:3, 3] - T[:3, 3])) for s in np.linspace(0, 1, 300)])
    tracked = track_path(CHAIN, q, path, 0.01)
    assert np.abs(np.diff(tracked.qs, axis=0)).max() < np.deg2rad(3.0)


def test_a_start_off_the_path_is_refused():
    q = np.deg2rad([10.0, 40.0, -80.0, 5.0, -40.0, 3.0])
    with pytest.raises(MachineError, match="off the path"):
        track_path(CHAIN, q + 0.1, straight(q, [0.1, 0.0, 0.0]), 0.01)
