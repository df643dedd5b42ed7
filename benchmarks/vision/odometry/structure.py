"""The crane's own structure in the picture: how often a pose is wrong and called OK, without and with a mask."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from benchmarks.vision.odometry.film import Film, FilmCase, nominal_machine
from server.camera.own_structure import mask_outlines, still_mask
from server.vision.contracts import Array, OdometryStatus
from server.vision.odometry import OdometrySettings, StereoOdometry

FRACS = (0.1, 0.2, 0.3, 0.4)
DISTANCES_M = (1.0, 1.3, 1.6, 2.0)
RATE_HZ = 10.0
WRONG_SIGMA, WRONG_MM = 4.0, 2.0
MASK_PAIRS = 12  # as many as the camera check keeps


@dataclass(frozen=True, slots=True)
class StructureRun:
    """One film, with the mask that `longreach camera check` would propose from it, or none."""

    film: FilmCase
    masked: bool

    @property
    def name(self) -> str:
        """One word, good as a file name."""
        return f"{self.film.name}-{'mask' if self.masked else 'plain'}"


def structure_runs(n: int, seed: int) -> list[StructureRun]:
    """n calibration paths at each share of the picture, and as many without structure: shapes, distances and the
    structure's texture in turn."""
    runs = []
    for number in range(seed, seed + n):
        shape, distance_m = ("circle", "paper")[number % 2], DISTANCES_M[number // 2 % len(DISTANCES_M)]
        for frac in (0.0, *FRACS):
            texture = (1.0, 0.5, 0.15)[number % 3]
            film = FilmCase(shape, distance_m, number, RATE_HZ, structure_frac=frac, structure_contrast_frac=texture)  # type: ignore[arg-type]
            runs += [StructureRun(film, masked) for masked in ((False, True) if frac else (False,))]
    return runs


def proposed_masks(film: Film) -> tuple[list[Array], list[Array]]:
    """Polygons of both eyes from some pairs along the path; none where nothing stood still."""
    pairs = [film.pair(int(k)) for k in np.linspace(0, len(film.jpegs) - 1, MASK_PAIRS)]
    masks = [still_mask([pair[eye] for pair in pairs]) for eye in range(2)]
    left, right = ([] if mask is None else list(mask_outlines(mask)) for mask in masks)
    return left, right


def run_structure(run: StructureRun, film: Film) -> dict[str, Any]:
    """One run, as JSON: pairs by state, and how many are wrong by more than they say while OK."""
    settings = OdometrySettings(sigma_scale_frac=0.0, readout_s=film.readout_s)
    odometry = StereoOdometry(nominal_machine().camera, settings)
    left_px, right_px = proposed_masks(film) if run.masked else ([], [])
    states, wrong, worst_mm = dict.fromkeys((status.value for status in OdometryStatus), 0), 0, 0.0
    for k, t_ns in enumerate(film.t_exposure_ns):
        masks = [film.tool_left_px, *left_px], [film.tool_right_px, *right_px]
        found = odometry.process(*film.pair(k), t_ns, *masks)
        error_mm = 1e3 * float(np.linalg.norm(found.T_vo_cam[:3, 3] - film.Ts_vo_cam[k][:3, 3]))
        sigma_mm = 1e3 * float(np.sqrt(np.linalg.eigvalsh(found.covariance[3:, 3:])[-1]))
        states[found.status.value] += 1
        if found.status is OdometryStatus.OK:
            worst_mm = max(worst_mm, error_mm)
            wrong += error_mm > max(WRONG_MM, WRONG_SIGMA * sigma_mm)
    return {"name": run.name, **asdict(run), "states": states, "wrong": int(wrong), "worst_mm": worst_mm}
