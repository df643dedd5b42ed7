"""The registration methods side by side: each turns a case into a rotation, or None when it refuses or is not there."""

import importlib
import importlib.util
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from longreach.bench_registration.cases import T_TCP_CAM_NOMINAL, RegistrationCase
from machine.rotations import Array, geodesic_angle, rotvec_from_rotation
from server.calibration.chords import chord_pairs, chord_vectors
from server.calibration.hybrid_mixture import MixtureSettings
from server.calibration.rotation_fit import fit_rotation
from server.calibration.time_offset import find_time_offset, positions_at
from server.calibration.trajectory_matching import DEFAULT_SETTINGS, estimate_camera_rotation
from server.calibration.trajectory_matching_paper import (
    coarse_frame_alignment,
    estimate_camera_rotation_paper,
    evenly_along,
)

OURS = "ours"
_POINTS_MAX = 100
_R_NOMINAL = T_TCP_CAM_NOMINAL[:3, :3]


@dataclass(frozen=True, slots=True)
class Trial:
    """One method on one case: rotation error [deg] or None, time [s]; ours also its squared error over covariance."""

    error_deg: float | None
    seconds: float
    chi2: float | None = None
    offset_error_s: float | None = None


def _ours(case: RegistrationCase) -> tuple[Array | None, float | None, float | None]:
    found = estimate_camera_rotation(case.camera, case.encoder, T_TCP_CAM_NOMINAL)
    if found.R_tcp_cam is None or found.covariance is None:
        return None, None, None
    error = rotvec_from_rotation(case.R_tcp_cam @ found.R_tcp_cam.T)
    chi2 = float(error @ np.linalg.solve(found.covariance, error))
    return _base_from(case, found.R_tcp_cam), chi2, found.time_offset_s - case.offset_s


def _chords_8_cm(case: RegistrationCase) -> Array:
    """The former default: robust fit on chords of one length, after the clock's search."""
    camera, encoder, s = case.camera, case.encoder, DEFAULT_SETTINGS
    vo, base = camera.Ts_vo_cam[:, :3, 3], _camera_by_kinematics(case)
    pairs = chord_pairs(positions_at(camera.t_s, encoder.t_s, base)[0], s.chord_m)
    clock = (s.time_offset_bound_s, s.time_offset_step_s, s.time_offset_contrast_min)
    offset = find_time_offset(camera.t_s, vo, encoder.t_s, base, pairs, *clock)
    points = positions_at(camera.t_s + offset.offset_s, encoder.t_s, base)[0]
    return fit_rotation(chord_vectors(points, pairs), chord_vectors(vo, pairs)).R_a_b


def _umeyama(case: RegistrationCase) -> Array:
    """evo's alignment with scale, positions paired by time."""
    points = positions_at(case.camera.t_s, case.encoder.t_s, _camera_by_kinematics(case))[0]
    return _umeyama_fit(case.camera.Ts_vo_cam[:, :3, 3], points)[0]


def _umeyama_offset(case: RegistrationCase) -> Array:
    """evo's alignment at the clock offset that leaves the smallest residual, grid of 25 ms within 0.25 s."""
    vo, base = case.camera.Ts_vo_cam[:, :3, 3], _camera_by_kinematics(case)
    found = []
    for offset_s in np.arange(-10, 11) * 0.025:
        points, inside = positions_at(case.camera.t_s + offset_s, case.encoder.t_s, base)
        found.append(_umeyama_fit(vo[inside], points[inside]))
    return min(found, key=lambda one: one[1])[0]


def _umeyama_fit(vo: Array, base: Array) -> tuple[Array, float]:
    umeyama = _module("evo.core.geometry").umeyama_alignment
    R, t, scale = umeyama(vo.T, base.T, True)
    misses = base - (scale * vo @ R.T + t)
    return R, float(np.mean(np.sum(misses**2, axis=1)))


def _mixture(case: RegistrationCase, use_axes: bool) -> Array | None:
    found = estimate_camera_rotation_paper(case.camera, case.encoder, _R_NOMINAL, MixtureSettings(use_axes=use_axes))
    return None if found.R_tcp_cam is None else _base_from(case, found.R_tcp_cam)


def _cpd(case: RegistrationCase) -> Array:
    """pycpd's rigid registration without pairs, from the paper's coarse alignment, at most 100 points of each path."""
    R_coarse = coarse_frame_alignment(case.encoder.Ts_base_tcp[0, :3, :3], _R_NOMINAL, case.camera.Ts_vo_cam[0, :3, :3])
    vo, base = case.camera.Ts_vo_cam[:, :3, 3] @ R_coarse.T, _camera_by_kinematics(case)
    vo, base = (points[evenly_along(points, _POINTS_MAX)] for points in (vo, base))
    cpd = _module("pycpd").RigidRegistration(
        X=base - base.mean(axis=0), Y=vo - vo.mean(axis=0), w=0.1, max_iterations=100, tolerance=1e-6
    )
    cpd.register()
    return np.asarray(cpd.R).T @ R_coarse  # pycpd multiplies points from the right


def _camera_by_kinematics(case: RegistrationCase) -> Array:
    Ts = case.encoder.Ts_base_tcp
    return Ts[:, :3, 3] + Ts[:, :3, :3] @ T_TCP_CAM_NOMINAL[:3, 3]


def _base_from(case: RegistrationCase, R_tcp_cam: Array) -> Array:
    return case.encoder.Ts_base_tcp[0, :3, :3] @ R_tcp_cam @ case.camera.Ts_vo_cam[0, :3, :3].T


@cache
def _module(name: str) -> ModuleType:
    return importlib.import_module(name)


METHODS: dict[str, Callable[[RegistrationCase], Any]] = {
    OURS: _ours,
    "chords 8 cm": _chords_8_cm,
    "Umeyama (evo)": _umeyama,
    "Umeyama + offset": _umeyama_offset,
    "HMM positions": lambda case: _mixture(case, use_axes=False),
    "HMM with axes": lambda case: _mixture(case, use_axes=True),
    "CPD (pycpd)": _cpd,
}
_NEEDS = {"Umeyama (evo)": "evo", "Umeyama + offset": "evo", "CPD (pycpd)": "pycpd"}


def available_methods() -> list[str]:
    """Names of the methods whose package is installed; evo and pycpd are optional."""
    return [name for name in METHODS if name not in _NEEDS or importlib.util.find_spec(_NEEDS[name]) is not None]


def try_method(name: str, case: RegistrationCase) -> Trial:
    """Run one method on one case; its error is that of the rotation base from odometry."""
    started = time.perf_counter()
    found = METHODS[name](case)
    seconds = time.perf_counter() - started
    R, chi2, offset_error_s = found if name == OURS else (found, None, None)
    error_deg = None if R is None else float(np.rad2deg(geodesic_angle(R, case.R_base_vo)))
    return Trial(error_deg, seconds, chi2, offset_error_s)
