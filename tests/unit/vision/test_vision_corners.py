"""Sub-pixel corners: one pixel convention, no bias, and covered sides are noticed."""

import cv2
import numpy as np
import pytest
from vision_scenes import machine, renderer, tcp_in_ooi, truth_of

from machine.camera import project_stereo
from machine.markers import marker_corners
from machine.poses import transform_points
from server.vision.edge_fit import SideFit, refine_corners, side_sags
from server.vision.errors import UnknownDictionaryError
from server.vision.marker_search import (
    cells_along_side,
    dictionary_by_name,
    dictionary_names,
    find_markers,
    refined_marker,
)


def soft_square(corners_px: np.ndarray, shape=(160, 160), blur_px=0.7) -> np.ndarray:
    """A dark square with exact corners, by 8-fold supersampling; pixel (0, 0) covers -0.5..0.5."""
    fine = 8
    v, u = np.mgrid[0 : shape[0] * fine, 0 : shape[1] * fine]
    x, y = (u + 0.5) / fine - 0.5, (v + 0.5) / fine - 0.5
    inside = np.ones(x.shape, dtype=bool)
    for start, end in zip(corners_px, np.roll(corners_px, -1, axis=0), strict=True):
        inside &= (end[0] - start[0]) * (y - start[1]) - (end[1] - start[1]) * (x - start[0]) >= 0.0
    cover = inside.reshape(shape[0], fine, shape[1], fine).mean(axis=(1, 3))
    small = 220.0 - 190.0 * cover
    return np.round(cv2.GaussianBlur(small, (0, 0), blur_px)).astype(np.uint8)


def test_corners_of_a_drawn_square_follow_the_pixel_convention():
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(12):
        turn = rng.uniform(0, np.pi / 2)
        frame = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * rng.uniform(25, 45)
        corners = square @ frame.T + 80 + rng.uniform(-0.5, 0.5, 2)
        fit, found = refine_corners(soft_square(corners), corners + rng.uniform(-1, 1, (4, 2)), 6)
        assert fit is SideFit.CLEAN
        errors.append(found - corners)
    errors = np.array(errors)
    assert np.abs(errors).max() < 0.05, "px"
    assert np.abs(errors.mean(axis=(0, 1))).max() < 0.01, "px: half a pixel would show here"


def test_rendered_markers_have_no_bias_and_small_noise():
    dictionary = dictionary_by_name(machine().dictionary)
    errors = []
    rng = np.random.default_rng(2)
    for distance_m in (0.45, 0.8):
        T_ooi_tcp = tcp_in_ooi(distance_m, (0.05, -0.2), (3.0, -4.0, 2.0))
        images = renderer().render_static(T_ooi_tcp, rng)
        T_cam_ooi = truth_of(T_ooi_tcp)["ooi"]
        for eye, image in enumerate(images):
            found = {one.marker_id: one for one in find_markers(image, dictionary)}
            for marker in machine().markers_on("ooi"):
                if marker.marker_id not in found:  # behind the tool
                    continue
                one = refined_marker(found[marker.marker_id], image, dictionary, machine().camera)
                if one.side_fit is not SideFit.CLEAN:
                    continue
                corners = transform_points(T_cam_ooi @ marker.T_on_marker, marker_corners(marker.side_m))
                errors.append(one.corners_px - project_stereo(machine().camera, corners)[eye])
    errors = np.array(errors)
    assert len(errors) >= 10
    assert np.sqrt((errors**2).mean()) < 0.06, "px rms"
    assert np.abs(errors.mean(axis=(0, 1))).max() < 0.02, "px bias"


def test_a_covered_side_is_told():
    corners = np.array([[40.0, 40.0], [110.0, 40.0], [110.0, 110.0], [40.0, 110.0]])
    image = soft_square(corners)
    image[90:160, 95:160] = 220
    assert refine_corners(image, corners, 6)[0] is SideFit.COVERED


def test_tiny_markers_fall_back_to_the_corner_search():
    corners = np.array([[40.0, 40.0], [47.0, 40.0], [47.0, 47.0], [40.0, 47.0]])
    assert refine_corners(soft_square(corners), corners, 6)[0] is SideFit.TOO_SMALL


def test_lens_bows_the_sides_near_the_image_border_only():
    square = np.array([[-40.0, -40.0], [40.0, -40.0], [40.0, 40.0], [-40.0, 40.0]])
    at_middle = side_sags(machine().camera, square + np.array([639.5, 359.5]))
    at_corner = side_sags(machine().camera, square + np.array([1180.0, 640.0]))
    assert np.abs(at_middle).max() < 0.05
    assert 0.02 < np.abs(at_corner).max() < 0.5


@pytest.mark.parametrize("name", ["DICT_4X4_50", "DICT_6X6_1000", "DICT_APRILTAG_36h11", "DICT_APRILTAG_16h5"])
def test_markers_of_any_dictionary_are_found(name):
    dictionary = dictionary_by_name(name)
    image = np.full((300, 300), 255, np.uint8)
    image[80:220, 90:230] = cv2.aruco.generateImageMarker(dictionary, 3, 140)
    (found,) = find_markers(image, dictionary)
    assert found.marker_id == 3
    assert cells_along_side(dictionary) == dictionary.markerSize + 2
    expected = np.array([[89.5, 79.5], [229.5, 79.5], [229.5, 219.5], [89.5, 219.5]])
    assert np.abs(refined_marker(found, image, dictionary, None).corners_px - expected).max() < 0.15, "px"


def test_an_unknown_dictionary_names_the_known_ones():
    assert len(dictionary_names()) >= 20
    with pytest.raises(UnknownDictionaryError, match="DICT_4X4_50"):
        dictionary_by_name("DICT_NOPE")
