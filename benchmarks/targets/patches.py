"""Patches measured on bare rock against the truth: error, stated uncertainty, and whether the ellipse holds it."""

from dataclasses import dataclass

import numpy as np

from benchmarks.targets.scene import bare_rock, left_eye, true_target, view
from machine.description import Machine
from server.targets.contracts import TargetSettings
from server.targets.surface import CHI2_2_95, measure_patch, uncertainty_95
from server.vision.look import pose_deviations
from sim_plc.camera.renderer import StereoRenderer

CHI2_3_95 = 7.815
PICTURES_PER_WALL = 4
CLICKS_PER_PICTURE = 6
MIDDLE_PX = ((300.0, 980.0), (120.0, 420.0))  # above the own tool


@dataclass(frozen=True, slots=True)
class PatchCase:
    """One click. Errors NaN when refused; chi2 of position (3 dof) and of the normal (2 dof)."""

    seed: int
    contrast_frac: float
    distance_m: float
    oblique_deg: float
    status: str
    depth_mm: float
    sigma_depth_mm: float
    normal_deg: float
    normal_95_deg: float
    chi2_position: float
    chi2_normal: float
    radius_mm: float

    @property
    def holds_position(self) -> bool:
        """Whether the 95 % ellipsoid of the position holds the truth."""
        return self.chi2_position <= CHI2_3_95

    @property
    def holds_normal(self) -> bool:
        """Whether the 95 % ellipse of the normal holds the truth."""
        return self.chi2_normal <= CHI2_2_95


def wall_cases(machine: Machine, seed: int, settings: TargetSettings) -> list[PatchCase]:
    """The clicks on one wall: four pictures from 0.3 to 0.9 m (tool), up to 30 deg oblique, six clicks each."""
    rng = np.random.default_rng([seed, 0x70617463])
    contrast = float(rng.uniform(0.5, 1.0))
    renderer = bare_rock(machine, seed, contrast)
    cases = []
    for number in range(PICTURES_PER_WALL):
        distance, tilt = float(rng.uniform(0.3, 0.9)), (4.0, 20.0)[number % 2]
        T = view(machine, rng, distance, tilt)
        pair = renderer.render_static(T, rng)
        cases += [
            _click(machine, renderer, seed, contrast, T, pair, _pixel(rng), settings) for _ in range(CLICKS_PER_PICTURE)
        ]
    return cases


def _pixel(rng: np.random.Generator) -> tuple[float, float]:
    (low_u, high_u), (low_v, high_v) = MIDDLE_PX
    return float(rng.uniform(low_u, high_u)), float(rng.uniform(low_v, high_v))


def _click(
    machine: Machine,
    renderer: StereoRenderer,
    seed: int,
    contrast: float,
    T_base_tcp: np.ndarray,
    pair: tuple[np.ndarray, np.ndarray],
    pixel: tuple[float, float],
    settings: TargetSettings,
) -> PatchCase:
    truth = true_target(renderer.relief, machine.camera, left_eye(renderer, T_base_tcp), pixel)
    ray = truth[:3, 3] / np.linalg.norm(truth[:3, 3])
    oblique = float(np.rad2deg(np.arccos(-ray @ truth[:3, 2])))
    found = measure_patch(*pair, machine.camera, pixel, settings)
    common = (seed, contrast, float(np.linalg.norm(truth[:3, 3])), oblique, found.status.value)
    if found.T_cam_target is None or found.covariance is None:
        return PatchCase(*common, *[float("nan")] * 7)
    error = pose_deviations(found.T_cam_target[None], truth)[0]
    plane = truth[:3, :2]  # two axes about which the normal tilts
    tilt, C_tilt = plane.T @ error[:3], plane.T @ found.covariance[:3, :3] @ plane
    return PatchCase(
        *common,
        depth_mm=1e3 * float(ray @ error[3:]),
        sigma_depth_mm=1e3 * float(np.sqrt(ray @ found.covariance[3:, 3:] @ ray)),
        normal_deg=float(np.rad2deg(np.arccos(np.clip(found.T_cam_target[:3, 2] @ truth[:3, 2], -1.0, 1.0)))),
        normal_95_deg=uncertainty_95(found.covariance)[0],
        chi2_position=float(error[3:] @ np.linalg.solve(found.covariance[3:, 3:], error[3:])),
        chi2_normal=float(tilt @ np.linalg.solve(C_tilt, tilt)),
        radius_mm=1e3 * found.radius_m,
    )
