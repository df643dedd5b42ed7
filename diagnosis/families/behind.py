"""Families of functions for measured points and marker corners: of posture, motion, time, place in the image."""

import numpy as np
from numpy.typing import NDArray

from diagnosis.behind.corner_residual import CornerResidual
from diagnosis.behind.link_angles import Path, followed, link_angles
from diagnosis.behind.point_residual import PointResidual
from diagnosis.search.candidates import SWINGS, named, put
from machine.effects.layout import ParameterSets, neutral_sets
from machine.rotations import Array

STILL_RAD_S = 2e-3
SMOOTH_ROWS = 11
IN_TURN = "the order of the poses"  # of poses at rest: a tracker's frame that drifts, a mount that settles
ORDERS = 4  # of waves over an angle, a turn
MINUTE_S = 60.0
SWINGS_OF = "swings of joint"
FIXED = WHICH_POINT, WHICH_MARKER = "which point", "which marker"  # no swing goes with it
PLACE = "place in the image"
SWINGS_HZ = np.geomspace(0.6, 6.0, 14)
SWUNG, DAMPING = 0.05, 0.1  # of a unit swing, and wide enough that one between two frequencies is a sum of both


def point_columns(measured: PointResidual) -> dict[str, Array]:
    """(3 m, k) by what they are functions of, as white as the residual; radial, tangential, up have own numbers."""
    data = measured.data
    out = {
        "posture": _each(_powers(data.q), 3),
        "waves over the angles": _each(_waves(data.q), 3),
        WHICH_POINT: _each(np.eye(int(data.which.max()) + 1)[data.which], 3),
    }
    if measured.paths:
        v, _ = _motion(measured.paths, measured.at, data.when)
        out["motion"] = _each(np.concatenate([v, _side(v)], axis=1), 3)
        out["acceleration"] = acceleration_columns(measured)
        out["time"] = _each(_time(data.when), 3)
    else:
        turn = np.argsort(np.argsort(data.when, kind="stable"))[:, None] / len(data.when)
        out[IN_TURN] = _each(turn - turn.mean(), 3)
    return {name: measured.noise.white(columns.T).T for name, columns in out.items()}


def acceleration_columns(measured: PointResidual) -> Array:
    """(3 m, 3 n) of tracked points, not weighed: what radial, tangential and up do with each joint's acceleration."""
    return _each(_motion(measured.paths, measured.at, measured.data.when)[1], 3)


def swing_columns(measured: PointResidual | CornerResidual, base: ParameterSets) -> dict[str, Array]:
    """(N, k) for each joint: what its motion sets swinging behind it, at each of some frequencies; white.

    Why: points and frames are too rare for the autocorrelation that tells of a swing in a driven stage.
    """
    if not followed(measured.paths):
        return {}
    out, plain = {}, measured(base)[0]
    for joint in range(1, measured.nominal.n + 1):
        (swing,) = named(SWINGS, (joint,))
        sizes = np.stack([np.full(len(SWINGS_HZ), SWUNG), SWINGS_HZ, np.full(len(SWINGS_HZ), DAMPING)], axis=1)
        out[f"{SWINGS_OF} {joint}"] = (measured(put(base, (swing,), sizes)) - plain).T / SWUNG
    return out


def corner_columns(seen: CornerResidual) -> dict[str, Array]:
    """(N, k) by what they are functions of, as white as the residual; u and v have their own numbers."""
    pixels, camera = seen.frames.pixels, seen.nominal.camera
    if camera is None:
        return {}
    there = np.isfinite(pixels)
    frame, eye, marker, _, axis = np.nonzero(there)
    centre, scale = np.array([camera.cx_px, camera.cy_px]), camera.fx_px
    rays = np.repeat(((pixels - centre) / scale)[..., None, :], 2, axis=-2)[there]  # both coordinates at each one
    x, y = rays.T
    r2 = x * x + y * y
    smooth = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y, x * r2, y * r2], axis=1)
    of_axis, of_marker = np.eye(2)[axis], np.eye(pixels.shape[2])[marker]
    own = _times(of_marker, of_axis)
    out = {
        PLACE: _times(smooth, np.eye(4)[2 * eye + axis]),
        WHICH_MARKER: own,
        "time": _times(_time(seen.frames.t_s)[frame], own),
    }
    if seen.on == "ooi":
        q = link_angles(seen.paths, neutral_sets(seen.nominal.n), 0, seen.at, seen.frames.t_s)
        v, _ = _motion(seen.paths, seen.at, seen.frames.t_s)
        later = v * _time(seen.frames.t_s)[:, :1]
        out["posture"] = _times(_powers(q)[frame], of_axis)
        out["motion"] = _times(np.concatenate([v, _side(v), later], axis=1)[frame], of_axis)
        out["motion by row"] = _times(v[frame], of_axis * y[:, None])
    return {name: seen.noise.white(columns.T, seen.frames.groups).T for name, columns in out.items()}


def _powers(q: Array) -> Array:
    """1, q, and products of two (m, 1 + n + n (n + 1) / 2), about the middle."""
    n = q.shape[1]
    scaled = (q - q.mean(axis=0)) / np.maximum(q.std(axis=0), 1e-9)
    pairs = [scaled[:, i] * scaled[:, k] for i in range(n) for k in range(i, n)]
    return np.stack([np.ones(len(q)), *scaled.T, *pairs], axis=1)


def _waves(q: Array) -> Array:
    """Sines and cosines of the first multiples of each angle (m, 2 n ORDERS)."""
    turned = (q[:, :, None] * np.arange(1, ORDERS + 1)).reshape(len(q), -1)
    return np.concatenate([np.sin(turned), np.cos(turned)], axis=1)


def _time(t_s: Array) -> Array:
    t = (t_s - t_s.min()) / MINUTE_S
    return np.stack([t, t * t], axis=1)


def _side(v: Array) -> Array:
    """Which way each joint moves."""
    return np.sign(np.where(np.abs(v) > STILL_RAD_S, v, 0.0))


def _each(columns: Array, axes: int) -> Array:
    """(m, k) -> (m axes, k axes)."""
    return np.asarray(np.kron(columns, np.eye(axes)), dtype=float)


def _times(a: Array, b: Array) -> Array:
    """All products of columns (m, i) and (m, k): (m, i k)."""
    return (a[:, :, None] * b[:, None, :]).reshape(len(a), -1)


def _motion(paths: tuple[Path, ...], at: NDArray[np.int64], t_s: Array) -> tuple[Array, Array]:
    """Encoders' speeds and accelerations (m, n) each at times (m,) in paths `at` (m,)."""
    n = paths[0].enc.shape[1]
    v, a = np.zeros((len(t_s), n)), np.zeros((len(t_s), n))
    window = np.ones(SMOOTH_ROWS) / SMOOTH_ROWS
    for k in np.unique(at):
        rows, path = at == k, paths[k]
        for j in range(n):
            smooth = np.convolve(path.enc[:, j], window, mode="same") if len(path.t_s) > SMOOTH_ROWS else path.enc[:, j]
            speed = np.gradient(smooth, path.t_s)
            v[rows, j] = np.interp(t_s[rows], path.t_s, speed)
            a[rows, j] = np.interp(t_s[rows], path.t_s, np.gradient(speed, path.t_s))
    return v, a
