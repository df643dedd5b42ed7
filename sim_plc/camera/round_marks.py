"""Boreholes and painted rings on the wall, ray cast: holes have depth, parallax, shadow, a chipped rim and dust."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.camera import project
from machine.poses import inverse_pose, pose, transform_points
from machine.rotations import Array
from sim_plc.camera.eye import EyeRays, can_project_all
from sim_plc.camera.texture import Field, Grey, value_noise
from sim_plc.camera.wall import Relief, height_at, pose_at_row, wall_hit
from sim_plc.world import RoundMark

MARKS_MAX = 12
_PLACES_M = ((-0.45, 0.45), (-0.12, 0.36))  # x and y in the OOI: in view from about half a metre
_HOLE_DIAMETERS_M, _RING_DIAMETERS_M = (0.045, 0.051, 0.064, 0.076), (0.08, 0.10)  # bits; stencils
_RING_SHARE = 0.25
_APART = 1.6  # of the sum of two radii
_TRIES = 400
_LINE_M = (0.008, 0.012)
_DEPTH_M = (0.12, 0.6)
_PAINTS = (228, 24)
_RIM = 72  # points of the rim
_ANGLES, _DEPTHS = 256, 64  # cells of a mark's own noise
_REACH = 4.5  # of what surrounds a hole, in radii: its wet streak
_HIT_STEPS = 3
_ALBEDO, _AMBIENT = 105.0, 0.3  # grey of fresh rock facing the light, and the share of it that comes from everywhere
_FRESH_GREY, _DUST_GREY = 165.0, 172.0


def draw_marks(seed: int, count: int, relief: Relief) -> tuple[RoundMark, ...]:
    """So many holes and rings on the rock, apart from each other; T_ooi_mark is the plane of the rim on the relief."""
    rng = np.random.default_rng([seed, 0x686F6C65])
    light = np.array([rng.uniform(-0.7, 0.7), rng.uniform(0.3, 0.9), 1.0])
    marks: list[RoundMark] = []
    for _ in range(_TRIES):
        if len(marks) == count:
            break
        ring = bool(rng.random() < _RING_SHARE)
        diameter_m = float(rng.choice(_RING_DIAMETERS_M if ring else _HOLE_DIAMETERS_M))
        x, y = (float(rng.uniform(*limits)) for limits in _PLACES_M)
        T = _on_relief(relief, x, y, 0.5 * diameter_m)
        gaps = [
            np.linalg.norm(T[:3, 3] - m.T_ooi_mark[:3, 3]) - _APART * 0.5 * (diameter_m + m.diameter_m) for m in marks
        ]
        if min(gaps, default=1.0) < 0.0:
            continue
        marks.append(
            RoundMark(
                kind="ring" if ring else "hole",
                T_ooi_mark=T,
                diameter_m=diameter_m,
                depth_m=0.0 if ring else float(rng.uniform(*_DEPTH_M)),
                line_m=float(rng.uniform(*_LINE_M)) if ring else 0.0,
                grey=int(rng.choice(_PAINTS)) if ring else 0,
                dust_frac=float(rng.uniform(0.0, 0.9)),
                wet=bool(rng.random() < 0.3) and not ring,
                light_ooi=light / np.linalg.norm(light),
                seed=int(rng.integers(2**31)),
            )
        )
    return tuple(marks)


def _on_relief(relief: Relief, x: float, y: float, radius_m: float) -> Array:
    """T_ooi_mark: mean and plane of the rim that a cylinder along the mark's normal cuts from the rock."""
    T = pose(np.eye(3), np.array([x, y, relief.mean_z_m + height_at(relief.heights_m, x, y)]))
    angle = np.linspace(0.0, 2.0 * np.pi, _RIM, endpoint=False)
    circle = radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
    for _ in range(3):  # rim and normal depend on each other; slopes are small, so this converges
        rim = []
        for dx, dy in circle:
            origin = transform_points(T, np.array([[dx, dy, 0.5]]))[0]
            rx, ry, rz = (float(part) for part in -T[:3, 2])
            px, py, h = wall_hit(relief.heights_m, relief.mean_z_m, T[2, 3] - relief.mean_z_m, origin, rx, ry, rz, 20)
            rim.append((px, py, relief.mean_z_m + h))
        points = np.array(rim)
        middle = points.mean(axis=0)
        z = np.linalg.svd(points - middle)[2][2]
        z *= np.sign(z[2])
        x_axis = np.array([1.0, 0.0, 0.0]) - z[0] * z
        x_axis /= np.linalg.norm(x_axis)
        T = pose(np.stack([x_axis, np.cross(z, x_axis), z], axis=1), middle)
    return T


@dataclass(frozen=True, slots=True)
class DrawnMark:
    """A mark with what is drawn of it once: `texture_noise` (angles, depths) and `rim_m`, its radius by angle."""

    mark: RoundMark
    texture_noise: Field
    rim_m: Array


def drawn_mark(mark: RoundMark) -> DrawnMark:
    """Its noise and its rim: chipped where the bit broke out, or an edge of paint that wobbles by 0.2 mm."""
    rng = np.random.default_rng([mark.seed, 0x72696D])
    noise = value_noise(rng, _ANGLES, _DEPTHS, 64, 32)
    radius = 0.5 * mark.diameter_m
    rim = np.full(_ANGLES, radius)
    angle = np.arange(_ANGLES) * 2.0 * np.pi / _ANGLES
    if mark.kind == "hole":
        for _ in range(int(rng.integers(1, 5))):
            off = np.abs((angle - rng.uniform(0.0, 2.0 * np.pi) + np.pi) % (2.0 * np.pi) - np.pi)
            width, deep = np.deg2rad(rng.uniform(8.0, 25.0)), rng.uniform(0.04, 0.2) * radius
            rim += deep * np.clip(1.0 - (off / width) ** 2, 0.0, None)
    else:
        rim += 0.0002 * value_noise(rng, 1, _ANGLES, 1, 32)[0]
    return DrawnMark(mark, noise, rim)


def paint_mark(image: Grey, eye: EyeRays, drawn: DrawnMark, Ts_ooi_cam: Array, relief: Relief) -> None:
    """Paint one mark over the wall; `Ts_ooi_cam` (n, 4, 4) at the shutter's key rows."""
    mark = drawn.mark
    roi = _mark_pixel_region(eye, mark, Ts_ooi_cam)
    if roi is None:
        return
    height = mark.T_ooi_mark[2, 3] - relief.mean_z_m
    figures = np.array(
        [0.5 * mark.diameter_m, mark.depth_m, mark.line_m, mark.grey, mark.dust_frac, float(mark.wet), height]
    )
    light = mark.T_ooi_mark[:3, :3].T @ mark.light_ooi
    T_mark_ooi = np.ascontiguousarray(inverse_pose(mark.T_ooi_mark)[:3])
    _paint_mark_pixels(
        image, eye.pixel_corner_rays, Ts_ooi_cam, relief.heights_m, relief.mean_z_m, T_mark_ooi, figures, light,
            drawn.texture_noise,
        drawn.rim_m, roi,
    )  # fmt: skip


def _mark_pixel_region(eye: EyeRays, mark: RoundMark, Ts_ooi_cam: Array) -> tuple[int, int, int, int] | None:
    """Pixels (u0, v0, u1, v1) that the mark and what surrounds it may touch; None: out of view."""
    reach, low = mark.diameter_m, -_REACH * 0.5 * mark.diameter_m if mark.wet else -mark.diameter_m
    box = np.array([[-reach, low, 0.0], [reach, low, 0.0], [reach, reach, 0.0], [-reach, reach, 0.0]])
    spots = []
    for T_ooi_cam in (Ts_ooi_cam[0], Ts_ooi_cam[-1]):
        points = transform_points(inverse_pose(T_ooi_cam), transform_points(mark.T_ooi_mark, box))
        if not can_project_all(points):
            return None
        spots.append(project(eye.camera, points))
    pixels = np.concatenate(spots)
    u0, v0 = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 2, 0)
    u1, v1 = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 3, [eye.camera.width_px, eye.camera.height_px])
    return (int(u0), int(v0), int(u1), int(v1)) if u0 < u1 and v0 < v1 else None


@njit(cache=True, nogil=True)
def _paint_mark_pixels(
    out: Grey,
    corners: NDArray[np.float32],
    keys: Array,
    heights: Array,
    mean_z: float,
    T_mark_ooi: Array,
    figures: Array,
    light: Array,
    noise: Field,
    rim: Array,
    roi: tuple[int, int, int, int],
) -> None:
    """One ray a pixel; near an edge the mean of 4 x 4, on a sheared grid so that edges along rows fall between them."""
    u0, v0, u1, v1 = roi
    T, d, p = np.empty((3, 4)), np.empty(3), np.empty(3)
    for v in range(v0, v1):
        pose_at_row(keys, v, out.shape[0], T)
        origin = T[:, 3].copy()
        for u in range(u0, u1):
            base = float(out[v, u])
            _pixel_ray_direction(corners, T, u, v, 0.5, 0.5, d)
            _ray_surface_hit(heights, mean_z, figures[6], origin, d, T_mark_ooi, p)
            r = np.hypot(p[0], p[1])
            pixel = abs((origin[2] - mean_z) / d[2]) * (corners[v, u + 1, 0] - corners[v, u, 0])
            slack = 1.5 * pixel
            n = 1
            if figures[0] - slack < r < rim.max() + slack or abs(r - figures[0] + figures[2]) < slack:
                n = 4
            total = 0.0
            for a in range(n):
                for b in range(n):
                    if n > 1:
                        _pixel_ray_direction(corners, T, u, v, (b + (a + 0.5) / n) / n, (a + (b + 0.5) / n) / n, d)
                        _ray_surface_hit(heights, mean_z, figures[6], origin, d, T_mark_ooi, p)
                    total += _ray_grey_value(T_mark_ooi, figures, light, noise, rim, p, d, base)
            out[v, u] = np.uint8(min(max(total / (n * n) + 0.5, 0.0), 255.0))


@njit(cache=True, nogil=True)
def _pixel_ray_direction(
    corners: NDArray[np.float32], T: Array, u: int, v: int, fx: float, fy: float, d: Array
) -> None:
    """Direction in OOI axes of the ray through a place (fx, fy) of the pixel, into `d`."""
    w00, w01, w10, w11 = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
    rx = (
        w00 * corners[v, u, 0]
        + w01 * corners[v, u + 1, 0]
        + w10 * corners[v + 1, u, 0]
        + w11 * corners[v + 1, u + 1, 0]
    )
    ry = (
        w00 * corners[v, u, 1]
        + w01 * corners[v, u + 1, 1]
        + w10 * corners[v + 1, u, 1]
        + w11 * corners[v + 1, u + 1, 1]
    )
    for i in range(3):
        d[i] = T[i, 0] * rx + T[i, 1] * ry + T[i, 2]


@njit(cache=True, nogil=True)
def _ray_surface_hit(
    heights: Array, mean_z: float, guess: float, origin: Array, d: Array, T_mark_ooi: Array, p: Array
) -> None:
    """Where the ray meets the rock's surface, in mark axes, into `p`."""
    x, y, h = wall_hit(heights, mean_z, guess, origin, d[0], d[1], d[2], _HIT_STEPS)
    for i in range(3):
        p[i] = T_mark_ooi[i, 0] * x + T_mark_ooi[i, 1] * y + T_mark_ooi[i, 2] * (mean_z + h) + T_mark_ooi[i, 3]


@njit(cache=True, nogil=True)
def _ray_grey_value(
    T: Array, figures: Array, light: Array, noise: Field, rim: Array, p: Array, d: Array, base: float
) -> float:
    """Grey that one ray along `d` sees which meets the rock's surface at `p` (mark axes); `base`: of the rock there."""
    px, py, pz = p
    dx, dy, dz = d
    radius, depth, line = figures[0], figures[1], figures[2]
    r = np.hypot(px, py)
    turn = (np.arctan2(py, px) / (2.0 * np.pi)) % 1.0
    cell = min(int(turn * rim.size), rim.size - 1)
    speck = noise[cell, int(r / radius * 20.0) % noise.shape[1]]
    if line > 0.0:  # painted ring
        if r > rim[cell] or r < rim[cell] - line:
            return base
        cover = min(max(0.88 + 0.12 * speck, 0.35), 1.0)
        return base + cover * (figures[3] - base)
    if r < radius:
        qx = T[0, 0] * dx + T[0, 1] * dy + T[0, 2] * dz
        qy = T[1, 0] * dx + T[1, 1] * dy + T[1, 2] * dz
        qz = T[2, 0] * dx + T[2, 1] * dy + T[2, 2] * dz
        return _hole_grey_value(px, py, pz, qx, qy, qz, radius, depth, light, noise)
    if r < rim[cell]:
        return 0.4 * base + 0.6 * _FRESH_GREY + 14.0 * speck
    grey = base
    if figures[5] > 0.0 and py < 0.0 and abs(px) < 0.5 * radius:
        fade = max(0.0, 1.0 + py / (_REACH * radius)) * (1.0 - (2.0 * px / radius) ** 2)
        grey *= 1.0 - 0.45 * fade
    dust = figures[4] * np.exp(-(((r - radius) / (0.4 * radius)) ** 2)) * min(max(1.0 + 0.4 * speck, 0.0), 1.5)
    return grey + min(dust, 1.0) * (_DUST_GREY - grey)


@njit(cache=True, nogil=True)
def _hole_grey_value(
    px: float, py: float, pz: float, qx: float, qy: float, qz: float, radius: float, depth: float, light: Array,
    noise: Field,
) -> float:  # fmt: skip
    """Grey of the hole's wall or floor that the ray p + t q meets, in mark axes: lit, in shadow, or dark with depth."""
    a, b, c = qx * qx + qy * qy, px * qx + py * qy, px * px + py * py - radius * radius
    t_wall = (-b + np.sqrt(max(b * b - a * c, 0.0))) / a if a > 1e-12 else 1e9
    t_floor = (-depth - pz) / qz if qz < -1e-9 else 1e9
    t = min(t_wall, t_floor)
    x, y, z = px + t * qx, py + t * qy, min(pz + t * qz, 0.0)
    on_wall = t_wall < t_floor
    facing = -(x * light[0] + y * light[1]) / radius if on_wall else light[2]
    direct = 0.0
    if facing > 0.0 and light[2] > 0.0:
        out = -z / light[2]
        if np.hypot(x + out * light[0], y + out * light[1]) < radius:
            direct = facing
    turn = (np.arctan2(y, x) / (2.0 * np.pi)) % 1.0
    speck = noise[min(int(turn * noise.shape[0]), noise.shape[0] - 1), int(-z / radius * 12.0) % noise.shape[1]]
    opening = 1.0 / (1.0 + (z / radius) ** 2)
    albedo = _ALBEDO * min(max(1.0 + 0.22 * speck, 0.3), 1.7)
    return 4.0 + albedo * ((1.0 - _AMBIENT) * direct + _AMBIENT * opening)
