"""Gaps over a wall that repeats itself: the camera moves on while it is covered, and one brick looks like the next."""

from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from benchmarks.vision.odometry.film import nominal_machine
from machine.camera import undistort_to_rays
from machine.rotations import Array
from server.vision.contracts import Image, OdometryStatus
from server.vision.odometry import OdometrySettings, StereoOdometry

MM_PER_PX = 1.0  # of the painted wall
WALL_PX = 4096
MORTAR_PX, MORTAR_GREY, GREY, SPREAD_GREY = 6, 60.0, 128.0, 25.0
GRAIN_PX = 2.0
NOISE_GREY, PSF_PX = 2.0, 0.7
WRONG_SIGMA, WRONG_MM = 4.0, 2.0
PERIOD_NS = 66_000_000
BEFORE, AFTER = 6, 10  # pairs


@dataclass(frozen=True, slots=True)
class GapCase:
    """One gap: bricks of `brick_mm` that differ by `own_frac` of their texture, `black` pairs while the camera moves by
    `step_mm` a pair, to the side and down."""

    seed: int
    brick_mm: int
    own_frac: float
    black: int
    step_mm: tuple[float, float]
    distance_m: float

    @property
    def name(self) -> str:
        """One word, good as a file name."""
        return f"gap-{self.seed}"


def gap_case(seed: int) -> GapCase:
    """A gap as drawn by this seed: up to three bricks long."""
    rng = np.random.default_rng([seed, 8])
    angle, brick_mm, black = rng.uniform(0.0, 2.0 * np.pi), int(rng.choice([50, 60, 80])), int(rng.integers(3, 20))
    step_mm = rng.uniform(0.5, 3.0) * brick_mm / black
    return GapCase(
        seed=seed,
        brick_mm=brick_mm,
        own_frac=float(rng.uniform(0.1, 0.5)),
        black=black,
        step_mm=(float(step_mm * np.cos(angle)), float(step_mm * np.sin(angle))),
        distance_m=float(rng.uniform(1.0, 1.6)),
    )


def brick_wall(brick_px: int, own_frac: float, rng: np.random.Generator) -> Array:
    """A wall (n, n) of equal bricks, each with a little texture of its own."""

    def grain(size: int) -> Array:
        rough = cv2.GaussianBlur(rng.normal(0.0, 1.0, (size, size)).astype(np.float32), (0, 0), GRAIN_PX)
        return np.asarray(SPREAD_GREY * rough / rough.std())

    brick = GREY + grain(2 * brick_px)[:brick_px, :brick_px]
    brick[:MORTAR_PX] = brick[:, :MORTAR_PX] = MORTAR_GREY
    n = WALL_PX // brick_px + 1
    return np.asarray(np.clip(np.tile(brick, (n, n))[:WALL_PX, :WALL_PX] + own_frac * grain(WALL_PX), 0.0, 255.0))


@lru_cache
def _rays() -> Array:
    camera = nominal_machine().camera
    columns, rows = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    pixels = np.column_stack([columns.ravel(), rows.ravel()]).astype(float)
    return undistort_to_rays(camera, pixels).reshape(camera.height_px, camera.width_px, 2)


def wall_pair(wall: Array, position_m: Array, rng: np.random.Generator) -> tuple[Image, Image]:
    """Both eyes square to the wall, the left one at this position (3,), z its distance."""
    eyes = []
    for offset_m in (0.0, nominal_machine().camera.baseline_m):
        places_m = _rays() * position_m[2] + position_m[:2] + [offset_m, 0.0]
        x, y = np.moveaxis((1e3 / MM_PER_PX * places_m + WALL_PX / 2).astype(np.float32), 2, 0)
        sharp = cv2.remap(wall.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        blurred = cv2.GaussianBlur(sharp, (0, 0), PSF_PX)
        eyes.append(np.clip(blurred + rng.normal(0.0, NOISE_GREY, blurred.shape), 0, 255).astype(np.uint8))
    return eyes[0], eyes[1]


def run_gap(case: GapCase) -> dict[str, Any]:
    """One gap, as JSON: poses after it by their state, and how many are wrong by more than they say while OK."""
    rng = np.random.default_rng(case.seed)
    wall = brick_wall(case.brick_mm, case.own_frac, rng)
    odometry = StereoOdometry(nominal_machine().camera, OdometrySettings(readout_s=0.0, sigma_scale_frac=0.0))
    states, wrong, worst_mm = dict.fromkeys((status.value for status in OdometryStatus), 0), 0, 0.0
    start_m = None  # the odometry's frame begins with its first pose
    for k in range(BEFORE + case.black + AFTER):
        way_m = 1e-3 * k * np.array(case.step_mm)
        pair = wall_pair(wall, np.array([*way_m, case.distance_m]), rng)
        if BEFORE <= k < BEFORE + case.black:
            pair = np.zeros_like(pair[0]), np.zeros_like(pair[1])
        found = odometry.process(*pair, k * PERIOD_NS)
        if start_m is None and found.status is not OdometryStatus.LOST:
            start_m = way_m
        if k < BEFORE + case.black or start_m is None:
            continue
        error_mm = 1e3 * float(np.linalg.norm(found.T_vo_cam[:3, 3] - [*(way_m - start_m), 0.0]))
        sigma_mm = 1e3 * float(np.sqrt(np.linalg.eigvalsh(found.covariance[3:, 3:])[-1]))
        states[found.status.value] += 1
        if found.status is OdometryStatus.OK:
            worst_mm = max(worst_mm, error_mm)
            wrong += error_mm > max(WRONG_MM, WRONG_SIGMA * sigma_mm)
    return {"name": case.name, "case": asdict(case), "states": states, "wrong": int(wrong), "worst_mm": worst_mm}
