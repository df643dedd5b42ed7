"""Texture, relief, and how a sparse map is painted."""

import itertools

import numpy as np
import pytest

from sim_plc.camera.texture import MEAN_GREY, TEXEL_M, best_level, rock_texture, texture_levels
from sim_plc.camera.wall import HEIGHT_M, WIDTH_M, height_at, paint_map, wall_hit, wall_relief


@pytest.fixture(scope="module")
def base() -> np.ndarray:
    return rock_texture(3, 1.0)


def test_texture_is_large_fine_rich_and_repeatable(base: np.ndarray) -> None:
    assert WIDTH_M >= 3.0
    assert HEIGHT_M >= 2.5
    assert TEXEL_M <= 0.001
    assert 30.0 < base.std() < 50.0  # grey levels
    assert abs(base.mean() - MEAN_GREY) < 4.0
    assert np.array_equal(base, rock_texture(3, 1.0))
    assert not np.array_equal(base, rock_texture(4, 1.0))


def test_texture_repeats_without_a_seam(base: np.ndarray) -> None:
    inside = np.abs(np.diff(base.astype(float), axis=1)).mean()
    seam = np.abs(base[:, 0].astype(float) - base[:, -1]).mean()
    assert seam < 1.3 * inside


def test_contrast_scales_the_departures_from_the_mean(base: np.ndarray) -> None:
    half = rock_texture(3, 0.5)
    assert half.std() / base.std() == pytest.approx(0.5, abs=0.03)  # clipping at full contrast takes a little


def test_levels_keep_the_mean_and_lose_detail(base: np.ndarray) -> None:
    levels = texture_levels(base)
    spreads = [level.grey_image.std() for level in levels]
    assert all(abs(level.grey_image.mean() - base.mean()) < 0.7 for level in levels)
    assert all(coarse < fine for fine, coarse in itertools.pairwise(spreads))
    assert best_level(levels, 1e-5) == 0
    assert levels[best_level(levels, 0.0026)].texel_x_m == pytest.approx(0.0016, rel=0.02)  # 1.4 m away


@pytest.mark.parametrize("relief_m", [0.02, 0.05])
def test_relief_has_its_range_is_periodic_and_hollow_behind_the_ooi(relief_m: float) -> None:
    relief = wall_relief(7, relief_m, 0.06)
    assert np.ptp(relief.heights_m) == pytest.approx(relief_m, abs=1e-9)
    assert relief.mean_z_m == -0.06
    here = height_at(relief.heights_m, 0.3, -0.2)
    assert height_at(relief.heights_m, 0.3 + WIDTH_M, -0.2 - HEIGHT_M) == pytest.approx(here, abs=1e-9)
    around = [height_at(relief.heights_m, 0.35 * np.cos(a), 0.35 * np.sin(a)) for a in np.linspace(0, 6.2, 40)]
    assert max(around) < 0.0  # m: the boards clear the rock
    slope = np.abs(np.diff(relief.heights_m, axis=1)).max() / (WIDTH_M / 256)
    assert slope < 0.5 * relief_m / 0.05


def test_no_relief_is_a_plane() -> None:
    assert not wall_relief(7, 0.0, 0.06).heights_m.any()


def test_a_ray_meets_the_relief_where_its_height_is() -> None:
    relief = wall_relief(7, 0.05, 0.06)
    origin = np.array([0.4, -0.3, 1.2])
    for dx, dy in np.random.default_rng(1).uniform(-1.0, 1.0, (50, 2)):
        x, y, _ = wall_hit(relief.heights_m, relief.mean_z_m, 0.0, origin, dx, dy, -1.0, 4)
        z = origin[2] - (x - origin[0]) / dx
        assert z == pytest.approx(relief.mean_z_m + height_at(relief.heights_m, x, y), abs=2e-5)  # m


def test_a_map_is_painted_bilinearly_and_wraps() -> None:
    columns, rows, step = 64, 32, 8
    ramp = np.tile(np.arange(columns, dtype=np.uint8) * 3, (rows, 1))
    image = np.pad(ramp, ((0, 1), (0, 1)), mode="wrap")
    out = np.empty((16, 32), np.uint8)
    u, v = np.meshgrid(step * np.arange(-1.0, 6.0), step * np.arange(-1.0, 4.0))
    paint_map(np.stack([0.5 * u + 10.25, 1.0 * v - 40.0], axis=-1), step, image, out)
    expected = 3.0 * (0.5 * np.arange(32) + 10.25)
    assert np.abs(out - expected).max() <= 0.6  # grey levels
    paint_map(np.stack([0.5 * u + 10.25 - 2.0 * columns, 1.0 * v], axis=-1), step, image, out)
    assert np.abs(out - expected).max() <= 0.6
