"""One pixel convention everywhere: the centre of the top left pixel is (0, 0). Half a pixel off anywhere fails here."""

import cv2
import numpy as np
import pytest
from vision_scenes import machine, renderer, tcp_in_ooi, truth_of

from machine.camera import project, project_stereo, undistort_to_rays
from machine.markers import marker_corners
from machine.poses import transform_points
from machine.targets import Board
from server.vision.charuco import board_corners
from server.vision.marker_search import dictionary_by_name, find_markers, refined_marker
from server.vision.odometry_align import align_reference_patches

CAMERA = machine().camera
OFF_MAX_PX = 0.1  # mean over many corners; half a pixel is five times that


def moment_centre(image: np.ndarray) -> np.ndarray:
    """Centre of gravity of what is darker than white (x, y), by the plain definition of the convention."""
    weight = 255.0 - image.astype(float)
    v, u = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    return np.array([(u * weight).sum(), (v * weight).sum()]) / weight.sum()


def test_the_centre_of_the_top_left_pixel_is_zero():
    image = np.full((40, 50), 255, np.uint8)
    image[0, 0] = 0
    assert moment_centre(image) == pytest.approx([0.0, 0.0])


def test_drawn_markers_begin_half_a_pixel_before_their_first_pixel():
    """OpenCV's detector and our refinement, on a picture drawn by neither renderer."""
    dictionary = dictionary_by_name("DICT_4X4_50")
    image = np.full((260, 280), 255, np.uint8)
    image[70:190, 81:201] = cv2.aruco.generateImageMarker(dictionary, 5, 120)
    (found,) = find_markers(image, dictionary)
    exact = np.array([[80.5, 69.5], [200.5, 69.5], [200.5, 189.5], [80.5, 189.5]])
    ours = refined_marker(found, image, dictionary, None).corners_px
    assert np.abs(ours.mean(axis=0) - exact.mean(axis=0)).max() < 0.02, "px"
    assert np.abs(ours - exact).max() < 0.05, "px"
    border = np.full_like(image, 255)
    border[70:190, 81:201] = 0
    assert moment_centre(border) == pytest.approx(exact.mean(axis=0), abs=1e-9)


def test_the_renderer_draws_where_the_camera_projects():
    T_ooi_tcp = tcp_in_ooi(0.7, (0.05, -0.2))
    errors = []
    dictionary = dictionary_by_name(machine().dictionary)
    for eye, image in enumerate(renderer(noise_grey=0.0).render_static(T_ooi_tcp)):
        found = {one.marker_id: one for one in find_markers(image, dictionary)}
        for marker in machine().markers_on("ooi"):
            if marker.marker_id in found:
                corners = transform_points(
                    truth_of(T_ooi_tcp)["ooi"] @ marker.T_on_marker, marker_corners(marker.side_m)
                )
                ours = refined_marker(found[marker.marker_id], image, dictionary, CAMERA)
                if not ours.covered:
                    errors.append(ours.corners_px - project_stereo(CAMERA, corners)[eye])
    assert len(errors) >= 4
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < OFF_MAX_PX, "px"


def test_projection_and_undistortion_are_each_others_inverse():
    pixels = np.array([[0.0, 0.0], [639.5, 359.5], [1279.0, 719.0], [-0.5, 719.5], [200.25, 511.75]])
    rays = undistort_to_rays(CAMERA, pixels)
    assert project(CAMERA, np.column_stack([rays, np.ones(len(rays))])) == pytest.approx(pixels, abs=1e-8)
    middle = project(CAMERA, np.array([[0.0, 0.0, 1.0]]))[0]
    assert middle == pytest.approx([CAMERA.cx_px, CAMERA.cy_px]), "the principal point is in the same pixels"


def test_opencv_projects_to_the_same_pixels():
    points = np.array([[0.1, -0.2, 1.0], [-0.4, 0.3, 0.9], [0.0, 0.0, 2.0]])
    K = np.array([[CAMERA.fx_px, 0, CAMERA.cx_px], [0, CAMERA.fy_px, CAMERA.cy_px], [0, 0, 1.0]])
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array(CAMERA.distortion))
    assert project(CAMERA, points) == pytest.approx(theirs.reshape(-1, 2), abs=1e-9)


def texture(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Smooth grey at continuous places."""
    return 128.0 + 50.0 * np.sin(0.31 * u + 0.2 * v) + 45.0 * np.cos(0.17 * u - 0.29 * v)


@pytest.mark.parametrize("scale", [0.7, 1.5])
def test_odometry_patches_are_sampled_at_pixel_centres(scale):
    """A change of scale turns a half-pixel error of the patch into one of the place."""
    v, u = np.mgrid[0:120, 0:120].astype(float)
    shift = np.array([3.3, -2.6])
    reference = np.round(texture(u, v)).astype(np.uint8)
    image = np.round(texture((u - shift[0]) * scale, (v - shift[1]) * scale)).astype(np.uint8)
    points = np.array([[40.0, 42.0], [51.3, 40.6], [45.5, 50.5]])
    exact = points / scale + shift
    found = align_reference_patches(
        reference, points, np.repeat(scale * np.eye(2)[None], 3, axis=0), image, exact + 0.7
    )
    assert found.valid.all()
    assert np.abs(found.points_px - exact).max() < 0.05, "px"


def test_board_corners_lie_between_pixels():
    """Squares of 40 px from pixel 30 on: their corners are at 29.5 + 40 k."""
    square = 40
    printed = cv2.aruco.CharucoBoard((5, 4), 0.04, 0.03, dictionary_by_name("DICT_4X4_50"))
    image = np.full((square * 4 + 60, square * 5 + 60), 255, np.uint8)
    image[30:-30, 30:-30] = printed.generateImage((square * 5, square * 4), marginSize=0, borderBits=1)
    image = cv2.GaussianBlur(image, (0, 0), 0.7)
    board = Board("charuco", "ooi", 5, 4, 0.04, 0.03, 0, legacy_pattern=False, T_on_board=np.eye(4))
    found = {one.marker_id: one.corners_px for one in find_markers(image, dictionary_by_name("DICT_4X4_50"))}
    corners = board_corners(image, board, found, CAMERA)
    x, y = np.meshgrid(29.5 + square * np.arange(1, 5), 29.5 + square * np.arange(1, 4))
    exact = np.column_stack([x.ravel(), y.ravel()])
    seen = np.isfinite(corners).all(axis=1)
    assert seen.sum() >= 8
    assert np.abs(np.mean(corners[seen] - exact[seen], axis=0)).max() < OFF_MAX_PX, "px"
