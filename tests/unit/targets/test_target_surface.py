"""A patch is measured to its stated uncertainty, or refused with the right reason."""

import cv2
import numpy as np
import pytest
from target_scenes import PIXEL, SETTINGS, machine, pair_at, rock

from benchmarks.targets.scene import bare_rock, left_eye, true_target, view
from machine.camera import undistort_to_rays
from server.targets.contracts import PatchStatus
from server.targets.surface import measure_patch, target_frame, uncertainty_95, with_roll
from server.vision.look import pose_deviations


def measured(left, right, pixel=PIXEL):
    return measure_patch(left, right, machine().camera, pixel, SETTINGS)


@pytest.mark.parametrize("distance_m", [0.3, 0.6, 0.9])
def test_position_and_normal_lie_within_four_stated_sigmas(distance_m):
    pair, T_ooi_cam = pair_at(distance_m, 2)
    patch = measured(*pair)
    assert patch.ok, patch.reason
    truth = true_target(rock().relief, machine().camera, T_ooi_cam, PIXEL)
    error = pose_deviations(patch.T_cam_target[None], truth)[0]
    assert error @ np.linalg.solve(patch.covariance, error) < 16.0 + 12.0  # chi2 of 6: 28 is exceeded once in 10 000
    assert np.linalg.norm(error[3:]) < 0.003
    assert uncertainty_95(patch.covariance)[0] < 2.0


def test_the_frame_is_right_handed_with_its_normal_towards_the_camera():
    T = target_frame(np.array([0.1, -0.2, -1.0]), np.array([0.0, 0.0, 1.0]))
    assert np.allclose(T[:3, :3].T @ T[:3, :3], np.eye(3))
    assert np.isclose(np.linalg.det(T[:3, :3]), 1.0)
    assert T[2, 2] < -0.9  # the normal comes towards the camera
    assert T[0, 0] > 0.9  # x to the right
    assert T[1, 1] < -0.9  # y up, against the image's rows


def test_a_roll_turns_x_towards_y_about_the_normal():
    patch = measured(*pair_at(0.6, 2)[0])
    turned = with_roll(patch, np.deg2rad(90.0))
    assert np.allclose(turned.T_cam_target[:3, 0], patch.T_cam_target[:3, 1])
    assert np.allclose(turned.T_cam_target[:3, 2], patch.T_cam_target[:3, 2])


def test_a_plain_surface_is_refused_for_its_texture():
    image = np.random.default_rng(0).normal(110.0, 2.0, (720, 1280)).clip(0, 255).astype(np.uint8)
    patch = measured(image, image)
    assert patch.status is PatchStatus.NO_TEXTURE
    assert "texture" in patch.reason
    assert patch.T_cam_target is None


def test_noise_alone_in_both_eyes_gives_no_patch():
    rng = np.random.default_rng(1)
    left, right = (rng.normal(110.0, 25.0, (720, 1280)).clip(0, 255).astype(np.uint8) for _ in range(2))
    assert not measured(left, right).ok


def test_glare_is_refused_with_its_share():
    (left, right), _ = pair_at(0.6, 2)
    left = left.copy()
    cv2.circle(left, (round(PIXEL[0]), round(PIXEL[1])), 15, 255, -1)
    patch = measured(left, right)
    assert patch.status is PatchStatus.GLARE
    assert "limit 5 %" in patch.reason


def test_a_pixel_at_the_border_is_refused():
    assert measured(*pair_at(0.6, 2)[0], pixel=(5.0, 300.0)).status is PatchStatus.OUTSIDE_IMAGE


def striped(shift_px: float) -> np.ndarray:
    """A flat wall at constant disparity whose texture repeats every 48 px, through the lens; right eye: shifted."""
    rng = np.random.default_rng(2)
    tile = cv2.GaussianBlur(rng.integers(0, 255, (720, 48)).astype(np.uint8), (0, 0), 2.0, borderType=cv2.BORDER_WRAP)
    tile = np.asarray(cv2.normalize(tile, None, 20, 235, cv2.NORM_MINMAX))
    wall = np.tile(tile, (1, 60))
    camera = machine().camera
    u, v = np.meshgrid(np.arange(1280.0), np.arange(720.0))
    rays = undistort_to_rays(camera, np.column_stack([u.ravel(), v.ravel()]))
    across = (rays[:, 0] * camera.fx_px + shift_px + 1400.0).reshape(u.shape).astype(np.float32)
    down = (rays[:, 1] * camera.fy_px + 360.0).reshape(u.shape).astype(np.float32)
    noise = rng.normal(0.0, 1.5, u.shape)
    return (cv2.remap(wall, across, down, cv2.INTER_CUBIC) + noise).clip(0, 255).astype(np.uint8)


def test_a_texture_that_repeats_along_the_row_is_refused():
    patch = measured(striped(0.0), striped(68.0))
    assert patch.status is PatchStatus.REPEATED_TEXTURE, patch.reason
    assert "limit 0.80" in patch.reason


def test_a_depth_edge_is_refused():
    """Right of the pixel stands another wall, 0.3 m nearer."""
    (left, right), _ = pair_at(0.6, 2)
    (near_left, near_right), T_ooi_near = pair_at(0.3, 9)
    edge = round(PIXEL[0]) + 4
    near_m = true_target(rock().relief, machine().camera, T_ooi_near, PIXEL)[2, 3]
    disparity = round(machine().camera.fx_px * machine().camera.baseline_m / near_m)
    both = left.copy(), right.copy()
    both[0][:, edge:] = near_left[:, edge:]
    both[1][:, edge - disparity :] = near_right[:, edge - disparity :]
    patch = measured(*both)
    assert patch.status in (PatchStatus.DEPTH_EDGE, PatchStatus.NOT_IN_BOTH_EYES), patch.reason


def test_a_surface_seen_from_too_far_is_refused_with_its_figures():
    far = bare_rock(machine(), seed=4)
    rng = np.random.default_rng(3)
    T = view(machine(), rng, 2.4)
    left, right = far.render_static(T, rng)
    patch = measured(left, right)
    assert left_eye(far, T)[2, 3] > 2.0
    assert patch.status in (PatchStatus.TOO_FAR, PatchStatus.NO_TEXTURE), patch.status
    assert "come nearer" in patch.reason
