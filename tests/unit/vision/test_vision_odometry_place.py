"""A place found again where the texture repeats: one brick farther on looks alike."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from benchmarks.vision.odometry.film import nominal_machine
from benchmarks.vision.odometry.gaps import BEFORE, GapCase, brick_wall, run_gap, wall_pair
from server.vision.odometry_features import repeats
from server.vision.odometry_sight import ImageSight

CASE = GapCase(seed=3, brick_mm=60, own_frac=0.3, black=15, step_mm=(4.0, 0.0), distance_m=1.3)


@pytest.mark.parametrize(
    "case",
    [
        CASE,
        replace(CASE, seed=7, brick_mm=80, own_frac=0.35, step_mm=(-0.9, -4.1)),
        GapCase(seed=31, brick_mm=50, own_frac=0.2, black=10, step_mm=(-1.86, 4.08), distance_m=1.5),  # 18 px a brick
    ],
)
def test_one_brick_off_is_never_called_ok(case):
    run = run_gap(case)
    assert run["wrong"] == 0
    assert run["states"]["ok"] + run["states"]["degraded"] + run["states"]["lost"] > BEFORE


def test_a_texture_of_its_own_is_found_again_at_once():
    run = run_gap(replace(CASE, own_frac=1.0))
    assert run["states"]["ok"] == sum(run["states"].values())
    assert run["worst_mm"] < 1.0


def test_a_picture_says_by_which_ways_it_repeats_itself():
    rng = np.random.default_rng(1)
    brick = cv2.GaussianBlur(rng.normal(128.0, 60.0, (64, 48)).astype(np.float32), (0, 0), 2.0)
    wall = np.clip(np.tile(brick, (12, 27))[:720, :1280], 0, 255).astype(np.uint8)
    ways = {tuple(np.round(way).astype(int)) for way in repeats(wall)}
    assert ways == {(48, 0), (-48, 0), (0, 64), (0, -64)}
    assert {abs(int(x)) for x, _ in repeats(wall, along_rows=True)} == {48, 96}


def test_both_eyes_do_not_meet_one_brick_off():
    """The nearest disparity that fits is one of many; the bricks' own texture says which."""
    rng, camera = np.random.default_rng(7), nominal_machine().camera
    left, right = wall_pair(brick_wall(80, 0.35, rng), np.array([0.0, 0.0, 1.11]), rng)
    mask = np.full(left.shape, 255, np.uint8)
    found = ImageSight(left, right, (mask, mask), 0).match_eyes(camera, 400, np.zeros((0, 2)))
    apart = np.median((found.left_px - found.right_px)[:, 0])
    assert apart == pytest.approx(camera.fx_px * camera.baseline_m / 1.11, abs=2.0), "px, raw"
    assert found.disparity_unique
