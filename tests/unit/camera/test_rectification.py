"""A rig with known numbers: rows agree after rectification, and points in space come out where they are."""

import cv2
import numpy as np
import pytest
from rig_samples import SIZE_PX, brown_rig, fisheye_rig, turned_rig

from machine.camera import project_stereo
from machine.rotations import Array
from server.camera.errors import StreamError
from server.camera.rectification import Rectifier, rectification_of, rectifying_maps, undistorted_rays
from server.camera.rectification_rig import EyeCalibration, RigCalibration, checked_rig
from server.vision.contracts import Image

RIGS = [brown_rig(), turned_rig(), fisheye_rig()]
NAMES = ["brown", "turned", "fisheye"]


def points_ahead(n: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    z = rng.uniform(0.6, 2.5, n)
    return np.column_stack([rng.uniform(-0.5, 0.5, n) * z, rng.uniform(-0.35, 0.35, n) * z, z])


def project_eye(eye: EyeCalibration, points_eye: Array) -> Array:
    """Raw pixels (n, 2) of points (n, 3) [m] in the eye's own frame, in front of it: OpenCV's own models."""
    points, zero = np.ascontiguousarray(points_eye, dtype=float).reshape(-1, 1, 3), np.zeros(3)
    project = cv2.fisheye.projectPoints if eye.lens_model == "fisheye" else cv2.projectPoints
    return np.asarray(project(points, zero, zero, eye.matrix, eye.coefficients)[0], dtype=float).reshape(-1, 2)


def seen_by(rig: RigCalibration, points_left: Array) -> tuple[Array, Array]:
    """Raw pixels in both eyes, by the rig's own model."""
    return (
        project_eye(rig.left, points_left),
        project_eye(rig.right, points_left @ rig.R_right_left.T + rig.t_right_left_m),
    )


@pytest.mark.parametrize("rig", RIGS, ids=NAMES)
def test_rows_agree_and_points_are_right(rig: RigCalibration) -> None:
    plan = rectification_of(rig, 60.0)
    points = points_ahead(400, 1)
    left, right = seen_by(rig, points)
    rays_left = undistorted_rays(rig.left, left, plan.R_rect_left)
    rays_right = undistorted_rays(rig.right, right, plan.R_rect_right)
    assert np.abs(rays_left - rays_right)[:, 1].max() * plan.camera.fx_px < 1e-6  # px
    z = plan.camera.baseline_m / (rays_left - rays_right)[:, 0]
    found = np.column_stack([rays_left * z[:, None], z])
    assert np.abs(found - points @ plan.R_rect_left.T).max() < 1e-6  # m


@pytest.mark.parametrize("rig", RIGS, ids=NAMES)
def test_maps_lead_back_to_where_the_eyes_see_the_point(rig: RigCalibration) -> None:
    """Without any inverse: rectified pixel by vision's own camera, then the map, against the raw pixel."""
    plan = rectification_of(rig, 60.0)
    maps = rectifying_maps(rig, plan)
    points = points_ahead(300, 2)
    rectified = project_stereo(plan.camera, points @ plan.R_rect_left.T)
    for pixels, (x, y), raw in zip(rectified, maps, seen_by(rig, points), strict=True):
        inside = (pixels > 1.0).all(axis=1) & (pixels < np.array(SIZE_PX) - 2.0).all(axis=1)
        at = pixels[inside].astype(np.float32)
        back = np.column_stack([cv2.remap(plane, at[:, 0], at[:, 1], cv2.INTER_LINEAR).ravel() for plane in (x, y)])
        assert inside.sum() > 100
        assert np.abs(back - raw[inside]).max() < 0.01  # px; the map is read between its own pixels


def test_the_camera_is_parallel_and_without_a_lens() -> None:
    plan = rectification_of(brown_rig(), 30.0)
    assert plan.camera.rectified
    assert plan.camera.distortion == (0.0,) * 5
    assert plan.camera.fx_px == plan.camera.fy_px
    assert plan.camera.rate_hz == 30.0
    assert plan.camera.baseline_m == pytest.approx(0.119978, abs=1e-6)
    assert 0.3 * SIZE_PX[0] < plan.camera.cx_px < 0.7 * SIZE_PX[0]


def test_turns_are_those_of_opencv() -> None:
    rig = turned_rig()
    R1, R2 = cv2.stereoRectify(
        rig.left.matrix,
        rig.left.coefficients[:5],
        rig.right.matrix,
        rig.right.coefficients,
        SIZE_PX,
        rig.R_right_left,
        rig.t_right_left_m.reshape(3, 1),
    )[:2]
    plan = rectification_of(rig, 60.0)
    np.testing.assert_allclose(plan.R_rect_left, R1, atol=1e-3)  # OpenCV turns about x by another convention
    np.testing.assert_allclose(plan.R_rect_left @ plan.R_rect_right.T, R1 @ R2.T, atol=1e-3)


def wall_pictures(rig: RigCalibration, seed: int) -> tuple[Image, Image]:
    """Both raw eyes of a textured wall 1 m away, pixels looked up on it by their rays (every 4th, rest between)."""
    texture = cv2.GaussianBlur(np.random.default_rng(seed).integers(0, 256, (1500, 2400)).astype(np.uint8), (0, 0), 3.5)
    texture = cv2.normalize(texture, None, 20, 235, cv2.NORM_MINMAX)
    v, u = np.mgrid[0 : rig.height_px + 4 : 4, 0 : rig.width_px + 4 : 4]
    pixels = np.column_stack([u.ravel(), v.ravel()]).astype(float)
    pictures = []
    for eye, R, t in ((rig.left, np.eye(3), np.zeros(3)), (rig.right, rig.R_right_left, rig.t_right_left_m)):
        rays = np.column_stack([undistorted_rays(eye, pixels), np.ones(len(pixels))]) @ R
        centre = -R.T @ t
        on_wall = centre + rays * ((1.0 - centre[2]) / rays[:, 2])[:, None]
        coarse = (on_wall[:, :2] * 600.0 + [1200.0, 750.0]).astype(np.float32).reshape(*u.shape, 2)
        y, x = np.mgrid[0 : rig.height_px, 0 : rig.width_px].astype(np.float32) / 4.0
        at = cv2.remap(coarse, x, y, cv2.INTER_LINEAR)
        picture = cv2.remap(texture, at[..., 0], at[..., 1], cv2.INTER_CUBIC)
        pictures.append(np.asarray(picture, np.uint8))
    return pictures[0], pictures[1]


def test_pictures_come_out_with_equal_rows() -> None:
    from server.camera.check_rig import match_eyes

    rig = turned_rig()
    plan = rectification_of(rig, 60.0)
    rectifier = Rectifier(rig, plan)
    raw = wall_pictures(rig, 3)
    spots_raw, spots = match_eyes(*raw), match_eyes(*rectifier.rectify(*raw))
    rectifier.close()
    assert np.abs(np.median(spots_raw[:, 3] - spots_raw[:, 1])) > 5.0  # px: the rig is really askew
    rows = spots[:, 3] - spots[:, 1]
    assert len(rows) > 200
    assert abs(float(np.median(rows))) < 0.05  # px
    assert float(np.median(np.abs(rows - np.median(rows)))) < 0.05
    z = plan.camera.fx_px * plan.camera.baseline_m / (spots[:, 0] - spots[:, 2])
    normal = plan.R_rect_left @ [0.0, 0.0, 1.0]
    rays = np.column_stack(
        [(spots[:, :2] - [plan.camera.cx_px, plan.camera.cy_px]) / plan.camera.fx_px, np.ones(len(z))]
    )
    depth = (rays * z[:, None]) @ normal
    assert float(np.median(depth)) == pytest.approx(1.0, abs=2e-4)  # m


def test_a_rectified_rig_is_left_alone() -> None:
    eye = EyeCalibration(707.0912, 707.0912, 601.8873, 183.1104)
    rig = checked_rig(RigCalibration(eye, eye, np.eye(3), np.array([-0.537, 0.0, 0.0]), 1226, 370), "sample")
    plan = rectification_of(rig, 10.0)
    assert (plan.camera.fx_px, plan.camera.cx_px, plan.camera.cy_px) == pytest.approx((707.0912, 601.8873, 183.1104))
    rectifier = Rectifier(rig, plan)
    picture = np.random.default_rng(0).integers(0, 256, (370, 1226)).astype(np.uint8)
    left, right = rectifier.rectify(picture, picture)
    rectifier.close()
    assert left is picture
    assert right is picture


def test_pictures_of_another_size_are_refused() -> None:
    rig = brown_rig()
    rectifier = Rectifier(rig, rectification_of(rig, 60.0))
    small = np.zeros((376, 672), np.uint8)
    with pytest.raises(StreamError, match=r"672 x 376 px, the calibration file is for 1280 x 720"):
        rectifier.rectify(small, small)
    rectifier.close()
