"""Noise, point spread, motion streaks and shutter times."""

import numpy as np
import pytest

from sim_plc.camera.renderer import StaticPose, key_poses, shutter_times_ns
from sim_plc.camera.sensor import add_noise, motion_blur, noise_bank, point_spread, streak_kernel


@pytest.fixture(scope="module")
def bank() -> np.ndarray:
    return noise_bank(np.random.default_rng(1))


@pytest.mark.parametrize("noise_grey", [2.0, 4.0])
def test_noise_has_its_spread_at_mid_grey_and_no_bias(bank: np.ndarray, noise_grey: float) -> None:
    image = np.full((720, 1280), 128, np.uint8)
    add_noise(image, bank, noise_grey, np.random.default_rng(2))
    assert image.mean() == pytest.approx(128.0, abs=0.05)
    assert image.std() == pytest.approx(np.hypot(noise_grey, 0.289), rel=0.02)  # 0.289: rounding to grey levels


def test_noise_grows_with_brightness_and_is_clipped(bank: np.ndarray) -> None:
    spreads = []
    for grey in (20, 128, 220):
        image = np.full((720, 1280), grey, np.uint8)
        add_noise(image, bank, 4.0, np.random.default_rng(3))
        spreads.append(image.std())
    assert spreads[0] < spreads[1] < spreads[2]
    white = np.full((720, 1280), 255, np.uint8)
    add_noise(white, bank, 4.0, np.random.default_rng(3))
    assert white.max() == 255
    assert white.min() > 220  # clipped, not wrapped around


def test_no_noise_is_the_identity(bank: np.ndarray) -> None:
    image = np.full((720, 1280), 77, np.uint8)
    add_noise(image, bank, 0.0, np.random.default_rng(4))
    assert (image == 77).all()
    assert point_spread(image, 0.0) is image


@pytest.mark.parametrize("streak", [(0.5, 0.0), (0.6, -1.1), (4.3, 0.0), (-6.0, 3.0)])
def test_streak_keeps_light_centre_and_second_moment(streak: tuple[float, float]) -> None:
    kernel = streak_kernel(np.array(streak)).astype(float)
    n = kernel.shape[0] // 2
    v, u = np.mgrid[-n : n + 1, -n : n + 1]
    assert kernel.sum() == pytest.approx(1.0, abs=1e-6)
    assert (kernel * u).sum() == pytest.approx(0.0, abs=1e-6)
    assert (kernel * v).sum() == pytest.approx(0.0, abs=1e-6)
    # a streak read between pixels is wider by up to 1/4 px^2
    slack = 1e-6 if np.hypot(*streak) < 2.0 else 0.26
    assert 0.0 <= (kernel * u * u).sum() - streak[0] ** 2 / 12 + 1e-9 < slack + 1e-9
    assert (kernel * u * v).sum() == pytest.approx(streak[0] * streak[1] / 12, abs=0.02)  # not mirrored


def test_short_streaks_are_left_out() -> None:
    image = np.eye(20, dtype=np.uint8)
    assert motion_blur(image, np.array([0.1, 0.1])) is image


def test_shutter_times_are_centred_on_the_middle_row() -> None:
    times = shutter_times_ns(1_000_000_000, 0.011, 5)
    assert times[0] == 1_000_000_000 - 5_500_000
    assert times[2] == 1_000_000_000
    assert times[-1] == 1_000_000_000 + 5_500_000
    assert key_poses(StaticPose(np.eye(4)), 0, 0.0, 5).shape == (5, 4, 4)
