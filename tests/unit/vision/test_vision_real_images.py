"""Real photographs and the KITTI clip: nothing depends on the renderer. Skipped where the data are not there."""

import cv2
import numpy as np
import pytest
from vision_scenes import DATA

from benchmarks.vision.evidence import (
    EvidenceError,
    corner_differences,
    grid_figures,
    odometry_figures,
    parse_poses,
    parse_tag_truth,
    rectified_camera,
    tag_figures,
)

needs_data = pytest.mark.skipif(
    not DATA.is_dir(), reason="real images are not here: no ../shared/data beside the project"
)


def grey(path):
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert image is not None, path
    return image


@needs_data
def test_tags_in_crowded_photographs_are_found_where_the_reference_has_them():
    figures = [
        tag_figures(grey(path), parse_tag_truth(path.with_suffix(".txt").read_text()))
        for path in sorted((DATA / "markers" / "apriltag_photos").glob("*.jpg"))
    ]
    listed, matched = sum(one.n_listed for one in figures), sum(one.n_matched for one in figures)
    assert listed == 47
    assert matched / listed >= 0.93
    assert sum(one.n_false for one in figures) == 0
    assert all(one.corner_rms_px < 0.75 for one in figures)


@needs_data
def test_all_400_markers_of_the_phone_photograph_are_found():
    figures = grid_figures(grey(DATA / "markers" / "aruco_photos" / "aruco_grid_iphone.jpg"), 400)
    assert (figures.n_found, figures.n_repeated, figures.n_false) == (400, 0, 0)
    assert figures.n_clean_sides > 380


@needs_data
def test_kitti_clip_rotation_and_length():
    clip = DATA / "stereo" / "kitti_clip"
    names = sorted(path.name for path in (clip / "image_l").glob("*.png"))
    pairs = ((grey(clip / "image_l" / name), grey(clip / "image_r" / name)) for name in names)
    camera = rectified_camera((clip / "calib.txt").read_text(), 1226, 370)
    figures = odometry_figures(camera, pairs, parse_poses((clip / "poses.txt").read_text()))
    assert figures.n_frames == 51
    assert figures.rotation_mean_deg <= 0.05
    assert figures.path_length_m == pytest.approx(60.5, rel=0.005)


def test_corner_order_and_pixel_centres_are_normalised():
    truth = parse_tag_truth("7, (10.5 20.5), (30.5 20.5), (30.5 40.5), (10.5 40.5)\n\n")
    assert truth.ids == (7,)
    assert truth.corners_px[0][0] == pytest.approx([10.0, 20.0])
    turned = np.roll(truth.corners_px[0], 1, axis=0)[::-1]
    assert np.abs(corner_differences(turned, truth.corners_px[0])).max() == 0.0


def test_texts_that_are_no_truth_are_refused():
    with pytest.raises(EvidenceError, match="line 1"):
        parse_tag_truth("7, (1 2)")
    with pytest.raises(EvidenceError, match="24"):
        rectified_camera("1 2 3", 10, 10)
