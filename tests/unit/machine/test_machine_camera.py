"""The camera model against OpenCV, its inverse, its Jacobian, and what it says about lenses and far rays."""

import dataclasses

import cv2
import numpy as np
import pytest
from machine_cases import MACHINE

from machine import camera as camera_module
from machine.camera import (
    distort_rays,
    distortion_jacobian,
    project,
    project_stereo,
    projection_jacobian,
    undistort_to_rays,
)
from machine.errors import MachineError
from machine.lens import distorted_radius_max, fold_radius

CAMERA = MACHINE.camera
LENSES = {
    "nominal": CAMERA.distortion,
    "tangential": (-0.042, 0.011, 1.5e-3, -2.0e-3, -0.005),
    "strong barrel": (-0.15, 0.03, 0.0, 0.0, 0.0),
    "pincushion": (0.08, 0.01, -1e-3, 1e-3, 0.002),
    "none": (0.0, 0.0, 0.0, 0.0, 0.0),
}


def lens(name):
    return dataclasses.replace(CAMERA, distortion=LENSES[name])


def points(n=500, seed=3):
    rng = np.random.default_rng(seed)
    z = rng.uniform(0.4, 3.0, n)
    return np.stack([rng.uniform(-1.1, 1.1, n) * z, rng.uniform(-0.6, 0.6, n) * z, z], axis=1)


def image_pixels():
    u, v = np.meshgrid(np.linspace(-0.5, CAMERA.width_px - 0.5, 81), np.linspace(-0.5, CAMERA.height_px - 0.5, 61))
    return np.stack([u.ravel(), v.ravel()], axis=1)


@pytest.mark.parametrize("name", LENSES)
def test_projection_equals_opencv(name):
    camera = lens(name)
    wanted, _ = cv2.projectPoints(points(), np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion))
    assert np.abs(project(camera, points()) - wanted.reshape(-1, 2)).max() < 1e-9  # px


@pytest.mark.parametrize("name", LENSES)
def test_undistortion_is_exact_to_1e_9_px_in_the_whole_image(name):
    camera = lens(name)
    rays = undistort_to_rays(camera, image_pixels())
    again = project(camera, np.column_stack([rays, np.ones(len(rays))]))
    assert np.abs(again - image_pixels()).max() < 1e-9  # px
    assert np.hypot(rays[:, 0], rays[:, 1]).max() < fold_radius(camera.distortion)


@pytest.mark.parametrize("name", LENSES)
def test_undistortion_agrees_with_opencv_where_opencv_converges(name):
    camera = lens(name)
    pixels = image_pixels()
    pixels = pixels[np.hypot(*(pixels - [CAMERA.cx_px, CAMERA.cy_px]).T) < 400.0]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    wanted = cv2.undistortPoints(
        pixels.reshape(-1, 1, 2), camera.matrix, np.array(camera.distortion), None, None, None, criteria
    ).reshape(-1, 2)
    assert np.abs(undistort_to_rays(camera, pixels) - wanted).max() * CAMERA.fx_px < 1e-6  # px


@pytest.mark.parametrize("name", LENSES)
def test_jacobians_equal_finite_differences(name):
    camera, p, h = lens(name), points(50), 1e-6
    J, K = projection_jacobian(camera, p), distortion_jacobian(camera, p[:, :2])
    for axis in range(3):
        step = h * np.eye(3)[axis]
        numeric = (project(camera, p + step) - project(camera, p - step)) / (2 * h)
        assert np.abs(J[:, :, axis] - numeric).max() < 1e-3  # px/m, of values up to 1e3
    for axis in range(2):
        step = h * np.eye(2)[axis]
        numeric = (distort_rays(camera, p[:, :2] + step) - distort_rays(camera, p[:, :2] - step)) / (2 * h)
        assert np.abs(K[:, :, axis] - numeric).max() < 1e-6 * max(1.0, np.abs(numeric).max())


def test_right_eye_sees_near_points_further_left():
    left, right = project_stereo(CAMERA, np.array([[0.0, 0.0, 1.0]]))
    assert left[0] == pytest.approx([639.5, 359.5], abs=1e-9)
    assert left[0, 0] - right[0, 0] == pytest.approx(CAMERA.fx_px * CAMERA.baseline_m, rel=2e-3)  # distortion on top
    plain = lens("none")
    left, right = project_stereo(plain, points())
    disparity = CAMERA.fx_px * CAMERA.baseline_m / points()[:, 2]
    assert np.abs(left - right - np.column_stack([disparity, np.zeros(500)])).max() < 1e-9


def test_points_at_or_behind_the_eye_have_no_pixel():
    behind = np.array([[0.1, 0.0, -1.0], [0.1, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert np.isnan(project(CAMERA, behind)).all(axis=1).tolist() == [True, True, False]
    assert np.isnan(projection_jacobian(CAMERA, behind)[:2]).any(axis=(1, 2)).all()


def test_pixels_that_no_ray_gives_get_the_outermost_ray():
    outside = np.array([[-300.0, -300.0], [5000.0, 359.5], [639.5, 359.5]])
    rays = undistort_to_rays(CAMERA, outside)
    limit = fold_radius(CAMERA.distortion)
    assert np.hypot(rays[:2, 0], rays[:2, 1]) == pytest.approx([limit, limit], rel=1e-6)
    assert rays[1, 0] > 0.0
    assert rays[2] == pytest.approx([0.0, 0.0], abs=1e-15)
    assert np.isnan(undistort_to_rays(CAMERA, np.array([[np.nan, 0.0]]))).any()


def test_fold_radius_is_where_the_distorted_radius_turns():
    r = np.linspace(0.0, 2.5, 250001)
    distorted = distort_rays(CAMERA, np.column_stack([r, np.zeros_like(r)]))[:, 0]
    turn = int(np.argmax(np.diff(distorted) < 0.0))
    assert fold_radius(CAMERA.distortion) == pytest.approx(r[turn], abs=2e-5)
    assert distorted_radius_max(CAMERA.distortion) == pytest.approx(distorted[turn], abs=1e-9)
    assert fold_radius((0.1, 0.0, 0.0, 0.0, 0.0)) == float("inf")
    assert distorted_radius_max((0.0, 0.0, 0.0, 0.0, 0.0)) == float("inf")


def test_empty_stacks_and_wrong_shapes():
    assert project(CAMERA, np.empty((0, 3))).shape == (0, 2)
    assert undistort_to_rays(CAMERA, np.empty((0, 2))).shape == (0, 2)
    for bad in (np.zeros(3), np.zeros((2, 2)), np.zeros((1, 4, 3))):
        with pytest.raises(MachineError, match=r"\(n, 3\)"):
            project(CAMERA, bad)
    for bad in (np.zeros(2), np.zeros((2, 3)), np.zeros((4, 1, 2))):
        with pytest.raises(MachineError, match=r"\(n, 2\)"):
            undistort_to_rays(CAMERA, bad)


def test_kernel_runs_as_plain_python_with_the_same_result():
    rays = points(20)[:, :2]
    arguments = (rays, np.array(CAMERA.distortion), fold_radius(CAMERA.distortion))
    plain, compiled = (
        camera_module.undistort_normalised.py_func(*arguments),
        camera_module.undistort_normalised(*arguments),
    )
    assert np.abs(plain - compiled).max() < 1e-13
