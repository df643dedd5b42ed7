"""SO(3) and SE(3): group axioms, conversions against SciPy, distances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from machine.errors import MachineError
from machine.poses import inverse_pose, pose, transform_points
from machine.rotations import (
    geodesic_angle,
    nearest_rotation,
    quat_wxyz_from_rotation,
    rotation_about,
    rotation_from_quat_wxyz,
    rotation_from_rotvec,
    rotvec_from_rotation,
    skew,
)

VECTORS = st.tuples(*[st.floats(-4.0, 4.0)] * 3).map(np.array)
AXES = VECTORS.filter(lambda v: np.linalg.norm(v) > 1e-3).map(lambda v: v / np.linalg.norm(v))
ROTATIONS = VECTORS.map(rotation_from_rotvec)
POSES = st.builds(pose, ROTATIONS, VECTORS)
TINY = st.sampled_from([0.0, 1e-16, 1e-12, 1e-9, 1e-8, 1.1e-8, 1e-6, 1e-4])


@given(ROTATIONS, ROTATIONS, ROTATIONS)
def test_rotations_form_a_group(a, b, c):
    assert np.abs((a @ b) @ c - a @ (b @ c)).max() < 1e-14
    assert np.abs(a @ a.T - np.eye(3)).max() < 1e-14
    assert np.linalg.det(a @ b) == pytest.approx(1.0, abs=1e-13)


@given(POSES, POSES, POSES)
def test_poses_form_a_group(a, b, c):
    assert np.abs((a @ b) @ c - a @ (b @ c)).max() < 1e-12
    assert np.abs(a @ inverse_pose(a) - np.eye(4)).max() < 1e-13
    assert np.abs(inverse_pose(a @ b) - inverse_pose(b) @ inverse_pose(a)).max() < 1e-12
    assert np.abs(inverse_pose(inverse_pose(a)) - a).max() < 1e-13


@given(POSES, POSES, VECTORS)
def test_neighbours_cancel(T_a_b, T_b_c, point_c):
    both = transform_points(T_a_b, transform_points(T_b_c, point_c[None]))
    assert np.abs(both - transform_points(T_a_b @ T_b_c, point_c[None])).max() < 1e-12


@given(VECTORS)
def test_rotation_vectors_agree_with_scipy_and_survive_the_round_trip(rotvec):
    R = rotation_from_rotvec(rotvec)
    assert np.abs(R - Rotation.from_rotvec(rotvec).as_matrix()).max() < 1e-13
    assert np.abs(rotation_from_rotvec(rotvec_from_rotation(R)) - R).max() < 1e-13
    assert np.linalg.norm(rotvec_from_rotation(R)) <= np.pi + 1e-12


@given(AXES, TINY)
def test_small_angles_keep_their_digits(axis, angle):
    assert np.abs(rotvec_from_rotation(rotation_from_rotvec(angle * axis)) - angle * axis).max() < 1e-16 + 1e-9 * angle


@given(AXES, TINY)
def test_angles_near_half_a_turn_are_exact(axis, below):
    R = rotation_from_rotvec((np.pi - below) * axis)
    assert geodesic_angle(np.eye(3), R) == pytest.approx(np.pi - below, abs=1e-12)  # rad
    assert np.abs(rotation_from_rotvec(rotvec_from_rotation(R)) - R).max() < 1e-13


@given(ROTATIONS)
def test_quaternions_are_wxyz_and_scipys_are_xyzw(rotation):
    w, x, y, z = quat_wxyz_from_rotation(rotation)
    scipys = Rotation.from_matrix(rotation).as_quat()
    assert w >= 0.0
    ours = np.array([x, y, z, w])
    assert min(np.abs(ours - scipys).max(), np.abs(ours + scipys).max()) < 1e-12
    assert np.abs(rotation_from_quat_wxyz(np.array([w, x, y, z])) - rotation).max() < 1e-13
    assert np.abs(rotation_from_quat_wxyz(-3.0 * np.array([w, x, y, z])) - rotation).max() < 1e-13


@given(ROTATIONS, ROTATIONS, ROTATIONS)
def test_the_geodesic_angle_is_a_distance(a, b, c):
    assert geodesic_angle(a, b) == pytest.approx(geodesic_angle(b, a), abs=1e-12)
    assert geodesic_angle(a, a) < 1e-15
    assert geodesic_angle(a, c) <= geodesic_angle(a, b) + geodesic_angle(b, c) + 1e-9
    assert geodesic_angle(c @ a, c @ b) == pytest.approx(geodesic_angle(a, b), abs=1e-9)
    assert geodesic_angle(a, b) == pytest.approx(
        (Rotation.from_matrix(a).inv() * Rotation.from_matrix(b)).magnitude(), abs=1e-9
    )


@given(ROTATIONS, st.floats(-0.05, 0.05), st.integers(0, 8))
def test_the_nearest_rotation_undoes_a_small_disturbance(rotation, size, entry):
    disturbed = rotation.copy()
    disturbed.flat[entry] += size
    nearest = nearest_rotation(disturbed)
    assert np.abs(nearest @ nearest.T - np.eye(3)).max() < 1e-13
    assert np.linalg.det(nearest) > 0.0
    assert np.linalg.norm(nearest - disturbed) <= np.linalg.norm(rotation - disturbed) + 1e-12


@given(VECTORS, VECTORS)
def test_skew_is_the_cross_product(a, b):
    assert np.abs(skew(a) @ b - np.cross(a, b)).max() < 1e-13


def test_the_quaternion_of_a_known_turn():
    """90 deg about z: (w, x, y, z) = (cos 45, 0, 0, sin 45 deg)."""
    half = np.sqrt(0.5)
    assert quat_wxyz_from_rotation(rotation_about("z", np.pi / 2)) == pytest.approx([half, 0.0, 0.0, half])
    assert rotation_about("x", np.pi / 2) @ [0.0, 1.0, 0.0] == pytest.approx([0.0, 0.0, 1.0])


def test_wrong_arguments_are_refused():
    with pytest.raises(MachineError, match="'w'"):
        rotation_about("w", 1.0)
    with pytest.raises(MachineError, match="not all 0"):
        rotation_from_quat_wxyz(np.zeros(4))
