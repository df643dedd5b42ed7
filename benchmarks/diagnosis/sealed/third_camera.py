"""The third plant's stereo camera: corners of the object's markers with every camera effect, and the pose read from
them.

Poses T_base_cam are those of the left eye; corners are (m, eyes, markers, 4, 2) [px], in the catalogue's order.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.diagnosis.sealed.third_arm import Array, rotation

SQUARE = np.array([(-0.5, 0.5, 0.0), (0.5, 0.5, 0.0), (0.5, -0.5, 0.0), (-0.5, -0.5, 0.0)])  # in sides, as OpenCV lists
MARGIN_PX = 3.0
ROUNDS = 12  # of Gauss and Newton; the pose converges in 5


@dataclass(frozen=True)
class Eyes:
    """A stereo camera on its mount and the markers that it sees; `offset_s`, `rate`: stamp less exposure."""

    width: int
    height: int
    focal: Array
    centre: Array
    k1: float
    baseline: float
    R_right: Array
    T_tcp_cam: Array
    offset_s: float
    rate: float
    rate_zero_s: float
    readout_s: float
    stamp_row: float
    corners_ooi: Array  # (markers, 4, 3) in the object's frame
    ids: tuple[int, ...]
    slip: Array  # (markers, 3) by which a loose marker moves in the object's frame
    slips_from_frac: float  # of the recording

    def stamp(self, exposure_s: Array) -> Array:
        """The stamp less the true time of an exposure, added to it."""
        return exposure_s + self.offset_s + self.rate * (exposure_s - self.rate_zero_s)


def eyes_of(machine: dict[str, Any], effects: list[dict[str, Any]]) -> Eyes:
    """The camera of a machine file with the camera and clock effects of a list."""
    camera, scale = machine["camera"], 1.0
    eyes = Eyes(
        camera["width_px"], camera["height_px"], np.array([camera["fx_px"], camera["fy_px"]]),
        np.array([camera["cx_px"], camera["cy_px"]]), 0.0, camera["baseline_m"], np.eye(3),
        np.array(camera["T_tcp_cam_left"], dtype=float).reshape(4, 4), 0.0, 0.0, 0.0, 0.0, 0.0, np.zeros((0, 4, 3)), (),
        np.zeros((len(machine["markers"]["marker"]), 3)), 1.0,
    )  # fmt: skip
    T = eyes.T_tcp_cam.copy()
    for effect in effects:
        name, values = effect["name"], effect["parameters"]
        if name == "focal_length_error":
            eyes = replace(eyes, focal=eyes.focal * (1.0 + values["scale_frac"]))
        elif name == "principal_point_error":
            eyes = replace(eyes, centre=eyes.centre + values["shift_px"] * np.array(values["direction"]))
        elif name == "lens_distortion":
            eyes = replace(eyes, k1=eyes.k1 + values["k1"])
        elif name == "marker_size_error":
            scale *= 1.0 + values["scale_frac"]
        elif name == "hand_eye_rotation":
            T[:3, :3] = T[:3, :3] @ rotation(np.array(values["axis"]), values["angle_rad"])
        elif name == "hand_eye_translation":
            T[:3, 3] += values["distance_m"] * np.array(values["direction"])
        elif name == "stereo_misalignment":
            eyes = replace(eyes, R_right=eyes.R_right @ rotation(np.array(values["axis"]), values["angle_rad"]))
        elif name in ("camera_latency", "clock_offset"):
            eyes = replace(eyes, offset_s=eyes.offset_s + values.get("latency_s", values.get("offset_s", 0.0)))
        elif name == "clock_drift":
            eyes = replace(eyes, rate=values["rate_ppm"] * 1e-6, rate_zero_s=values["zero_s"])
        elif name == "rolling_shutter":
            eyes = replace(eyes, readout_s=values["readout_s"], stamp_row=values["stamp_row"])
        elif name == "loose_marker":
            eyes.slip[values["marker"]] = 0.8 * values["slip_m"], -0.6 * values["slip_m"], 0.0
            eyes = replace(eyes, slips_from_frac=values["from_frac"])
    markers = [marker for marker in machine["markers"]["marker"] if marker["on"] == "ooi"]
    poses = np.array([marker["T_on_marker"] for marker in markers], dtype=float).reshape(-1, 4, 4)
    corners = SQUARE * np.array([marker["side_m"] * scale for marker in markers])[:, None, None]
    corners = corners @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
    return replace(eyes, T_tcp_cam=T, corners_ooi=corners, ids=tuple(marker["id"] for marker in markers))


def project(eyes: Eyes, T_cam_ooi: Array, slipped: Array) -> Array:
    """Corners (m, 2, markers, 4, 2) [px] of the object at T_cam_ooi (m, 4, 4); NaN behind the camera.

    Args: slipped: (m,) whether the loose marker has slipped.
    """
    places = eyes.corners_ooi + slipped[:, None, None, None] * eyes.slip[:, None, :]
    left = np.einsum("mij,mkcj->mkci", T_cam_ooi[:, :3, :3], places) + T_cam_ooi[:, None, None, :3, 3]
    right = (left - np.array([eyes.baseline, 0.0, 0.0])) @ eyes.R_right
    seen = np.stack([left, right], axis=1)
    ray = seen[..., :2] / np.where(seen[..., 2:] > 0.0, seen[..., 2:], np.nan)
    ray = ray * (1.0 + eyes.k1 * (ray**2).sum(axis=-1, keepdims=True))
    return eyes.focal * ray + eyes.centre


def shuttered(eyes: Eyes, apart_s: float, pixels: Array, later: Array) -> Array:
    """Corners where each row is exposed at its own time; `later`: the same corners apart_s after."""
    if eyes.readout_s == 0.0:
        return pixels
    share = pixels[..., 1:] / (eyes.height - 1.0) - 0.5 + 0.5 * eyes.stamp_row
    return pixels + (later - pixels) / apart_s * share * eyes.readout_s


def inside(eyes: Eyes, pixels: Array) -> Array:
    """Which markers have all corners in the picture (m, 2, markers)."""
    size = np.array([eyes.width, eyes.height])
    with np.errstate(invalid="ignore"):
        within = (pixels > MARGIN_PX) & (pixels < size - 1.0 - MARGIN_PX)
    return np.asarray(within.all(axis=(-1, -2)))


def read_poses(eyes: Eyes, pixels: Array, start: Array) -> Array:
    """T_cam_ooi (m, 4, 4) by least squares over the corners (m, 2, markers, 4, 2) as `eyes` believes them."""
    T, fixed = start.copy(), np.zeros(len(start))
    steps = np.concatenate([np.zeros((1, 6)), 1e-6 * np.eye(6)])
    for _ in range(ROUNDS):
        tried = np.stack([_stepped(T, np.broadcast_to(step, (len(T), 6))) for step in steps])
        drawn = np.stack([project(eyes, T_tried, fixed).reshape(len(T), -1) for T_tried in tried])
        J = np.moveaxis((drawn[1:] - drawn[0]) / 1e-6, 0, -1)
        miss = pixels.reshape(len(T), -1) - drawn[0]
        T = _stepped(T, np.linalg.solve(J.transpose(0, 2, 1) @ J, (J.transpose(0, 2, 1) @ miss[..., None]))[..., 0])
    return T


def _stepped(T: Array, step: Array) -> Array:
    out = T.copy()
    for k, v in enumerate(step):
        angle = float(np.linalg.norm(v[:3]))
        out[k, :3, :3] = T[k, :3, :3] @ rotation(v[:3], angle) if angle > 0.0 else T[k, :3, :3]
        out[k, :3, 3] = T[k, :3, 3] + v[3:]
    return out
