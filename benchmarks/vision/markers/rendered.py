"""Part (ii): images of the dense ray caster through search, refinement and pose."""

from dataclasses import asdict, dataclass

import numpy as np

from benchmarks.vision.markers.cells import Cell, random_pose
from benchmarks.vision.markers.corner_noise import corner_covariances
from benchmarks.vision.markers.exact import look
from benchmarks.vision.markers.images import MARKER_ID, SensorSettings, Studio, sensed
from benchmarks.vision.markers.judged import counts, normalised_bias, ratios, tilt_bound_deg
from benchmarks.vision.markers.opencv_rivals import ippe_left
from benchmarks.vision.markers.optimal import correlated_bounds, predict
from machine.description import Machine
from machine.markers import marker_corners
from machine.rotations import Array
from server.vision.marker_search import dictionary_by_name, find_markers, refined_marker
from server.vision.object_pose import PoseSettings

_BACKGROUND_GREY = 128


@dataclass(frozen=True, slots=True)
class RenderedCell:
    """What came out of one rendered cell. corner_sigma_px: rms of the corner errors, of one coordinate.

    "ours" and `known` are told that noise, "ours, shipped" and `shipped` are the server's own setting.
    """

    side_m: float
    distance_m: float
    tilt_deg: float
    n: int
    missed: int  # looks in which an eye did not find the marker, or found it covered
    corner_sigma_px: float
    corner_bias_px: list[float]
    outward_bias_px: float  # mean error away from the marker's middle
    tilt_bound_deg: float
    ratios: dict[str, dict[str, float]]
    biases: dict[str, list[float]]
    known: dict[str, int]
    shipped: dict[str, int]


@dataclass(frozen=True, slots=True)
class RenderedCorners:
    """Corners found (n, 16) and true (n, 16) [raw px], true poses (n, 4, 4); how many looks were missed."""

    seen: Array
    exact: Array
    truths: Array
    missed: int


def find_in_image(machine: Machine, image: np.ndarray) -> Array | None:
    """The full path in one eye: search, decode, refine; corners (4, 2) [raw px], None where there is no clean one."""
    dictionary = dictionary_by_name(machine.dictionary)
    for found in find_markers(image, dictionary):
        if found.marker_id == MARKER_ID:
            one = refined_marker(found, image, dictionary, machine.camera)
            return None if one.covered else one.corners_px
    return None


def _corners_in(machine: Machine, studio: Studio, T: Array, settings: SensorSettings, rng: np.random.Generator):
    found = []
    for eye in (0, 1):
        window, sharp = studio.sharp(T, eye)
        image = np.full((machine.camera.height_px, machine.camera.width_px), _BACKGROUND_GREY, np.uint8)
        image[window.v0 : window.v1, window.u0 : window.u1] = sensed(sharp, settings, rng)
        found.append(find_in_image(machine, image))
    return None if found[0] is None or found[1] is None else np.concatenate([one.ravel() for one in found])


def collect(
    cell: Cell, machine: Machine, studio: Studio, n: int, seed: int, settings: SensorSettings
) -> RenderedCorners:
    """Corners of n looks of one cell through the full path."""
    rng = np.random.default_rng(cell.seed(seed))
    truths, seen = [], []
    for _ in range(n):
        T = random_pose(cell, machine.camera, rng)
        corners = _corners_in(machine, studio, T, settings, rng)
        if corners is not None:
            truths.append(T)
            seen.append(corners)
    if not seen:
        return RenderedCorners(np.empty((0, 16)), np.empty((0, 16)), np.empty((0, 4, 4)), n)
    exact = predict(machine.camera, np.array(truths), marker_corners(cell.side_m))
    return RenderedCorners(np.array(seen), exact, np.array(truths), n - len(seen))


def run_rendered_cell(
    cell: Cell, machine: Machine, studio: Studio, n: int, seed: int, settings: SensorSettings
) -> RenderedCell:
    """n looks of one cell: corner covariance first, then poses against the bound that it gives."""
    found = collect(cell, machine, studio, n, seed, settings)
    errors = (found.seen - found.exact).reshape(-1, 2, 4, 2)
    if len(errors) < 2:
        nothing = {"tilt": float("nan"), "lateral": float("nan"), "depth": float("nan")}
        return RenderedCell(
            cell.side_m, cell.distance_m, cell.tilt_deg, n, found.missed, float("nan"), [], float("nan"),
            float("nan"), {"ours": nothing}, {}, {}, {},
        )  # fmt: skip
    bias = errors.mean(axis=(0, 1, 2))
    sigma = float(np.sqrt(np.mean((errors - bias) ** 2)))
    exact = found.exact.reshape(-1, 2, 4, 2)
    away = exact - exact.mean(axis=2, keepdims=True)
    away /= np.linalg.norm(away, axis=3, keepdims=True)
    covariances = corner_covariances(errors, exact)
    best = correlated_bounds(machine.camera, found.truths, marker_corners(cell.side_m), covariances)
    ours = look(machine.camera, cell.side_m, found.seen, PoseSettings(sigma_px=sigma))
    shipped = look(machine.camera, cell.side_m, found.seen)
    eyes = np.array([0.5 * machine.camera.baseline_m, 0.0, 0.0])
    good = np.isfinite(ours.Ts).all(axis=(1, 2))
    rivals = np.array([ippe_left(machine.camera, cell.side_m, one[:8].reshape(4, 2)) for one in found.seen])
    return RenderedCell(
        side_m=cell.side_m,
        distance_m=cell.distance_m,
        tilt_deg=cell.tilt_deg,
        n=int(good.sum()),
        missed=found.missed + int((~good).sum()),
        corner_sigma_px=sigma,
        corner_bias_px=[float(value) for value in bias],
        outward_bias_px=float(np.mean(np.sum(errors * away, axis=3))),
        tilt_bound_deg=tilt_bound_deg(found.truths, best),
        ratios={
            "ours": ratios(ours.Ts, found.truths, best),
            "ours, shipped": ratios(shipped.Ts, found.truths, best),
            "IPPE": ratios(rivals[:, 0], found.truths, best),
            "IPPE+LM": ratios(rivals[:, 1], found.truths, best),
        },
        biases=normalised_bias(ours.Ts[good], found.truths[good], best[good]),
        known=counts(ours, found.truths, cell.tilt_deg, eyes),
        shipped=counts(shipped, found.truths, cell.tilt_deg, eyes),
    )


def settings_name(settings: SensorSettings) -> str:
    """For file names."""
    return "-".join(f"{name[0]}{value:g}" for name, value in asdict(settings).items())
