"""Real and simulated hand-eye streams, and trajectories beside evo's alignment."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.hand_eye.streams import read_hand_eye, read_trajectories
from machine.rotations import Array, geodesic_angle
from server.calibration.chord_rotation import fit_chord_rotation
from server.calibration.chords import arc_lengths, positions_at
from server.calibration.hand_eye import HandEyeEstimate, HandPoses, estimate_hand_eye, solve_ax_yb
from server.calibration.hand_eye_fit import inverse_poses, rotation_vectors
from server.calibration.rotation_fit import fit_scale, kabsch

_PAIR_WITHIN_S = 0.01


@dataclass(frozen=True, slots=True)
class PairResiduals:
    """Residuals of A X = Y B over all paired samples: the angle [deg], and in the camera and in the base [mm]."""

    estimate: HandEyeEstimate
    n: int
    median_deg: float
    p90_deg: float
    camera_median_mm: float
    base_median_mm: float
    base_p90_mm: float
    base_median_mm_no_offset: float


def hand_eye_residuals(folder: Path, name: str) -> PairResiduals:
    """Our estimate from both streams with the offset searched, and its residuals; beside it the offset held at 0.

    In the camera the miss of the target's position; in the base |(A X).p - (Y B).p|, where the camera's rotation error
    acts over the distance to the target.
    """
    hand_stream, cam_stream = read_hand_eye(folder, name)
    Ts_cam_target = inverse_poses(cam_stream.Ts)
    found = estimate_hand_eye(hand_stream.t_s, hand_stream.Ts, cam_stream.t_s, Ts_cam_target)
    if found.T_hand_cam is None or found.T_base_target is None:
        raise RuntimeError(f"{name}: {found.reason}")
    hand = HandPoses(hand_stream.t_s, hand_stream.Ts, gap_max_s=0.2)
    inside = hand.covers_times(cam_stream.t_s + found.time_offset_s, 0.0)
    As = hand.poses_at(cam_stream.t_s[inside] + found.time_offset_s)
    misses = inverse_poses(found.T_base_target @ cam_stream.Ts[inside]) @ As @ found.T_hand_cam
    degrees = np.rad2deg(np.linalg.norm(rotation_vectors(misses[:, :3, :3]), axis=1))
    seen = (inverse_poses(As @ found.T_hand_cam) @ found.T_base_target)[:, :3, 3] - Ts_cam_target[inside][:, :3, 3]
    base_mm = 1e3 * np.linalg.norm(misses[:, :3, 3], axis=1)
    return PairResiduals(
        estimate=found,
        n=int(inside.sum()),
        median_deg=float(np.median(degrees)),
        p90_deg=float(np.percentile(degrees, 90)),
        camera_median_mm=1e3 * float(np.median(np.linalg.norm(seen, axis=1))),
        base_median_mm=float(np.median(base_mm)),
        base_p90_mm=float(np.percentile(base_mm, 90)),
        base_median_mm_no_offset=_base_median_mm(hand, cam_stream.t_s[inside], cam_stream.Ts[inside]),
    )


def _base_median_mm(hand: HandPoses, t_s: Array, Bs: Array) -> float:
    As = hand.poses_at(t_s)
    found = solve_ax_yb(As, Bs)
    if found.T_hand_cam is None or found.T_base_target is None:
        return float("nan")
    return 1e3 * float(np.median(np.linalg.norm((As @ found.T_hand_cam - found.T_base_target @ Bs)[:, :3, 3], axis=1)))


@dataclass(frozen=True, slots=True)
class Alignment:
    """Absolute trajectory error [m] after alignment, by least squares (ours, evo's) with free scale and with scale 1;
    by chords with free scale, and how far these turn it from the least-squares one [deg].
    """

    n: int
    ate_m: float
    evo_ate_m: float | None
    rigid_ate_m: float
    evo_rigid_ate_m: float | None
    chords_ate_m: float
    chords_turned_deg: float


def align_trajectories(folder: Path, name: str) -> Alignment:
    """The alignments on poses paired within 10 ms; the least-squares ones must be evo's."""
    estimate, truth = read_trajectories(folder, name)
    nearest = np.clip(np.searchsorted(truth.t_s, estimate.t_s), 1, len(truth.t_s) - 1)
    nearest -= np.abs(truth.t_s[nearest - 1] - estimate.t_s) < np.abs(truth.t_s[nearest] - estimate.t_s)
    close = np.abs(truth.t_s[nearest] - estimate.t_s) <= _PAIR_WITHIN_S
    seen, true = estimate.Ts[close, :3, 3], truth.Ts[nearest[close], :3, 3]
    ones = np.ones(len(seen))
    centred, centred_true = seen - seen.mean(axis=0), true - true.mean(axis=0)
    R = kabsch(centred_true, centred, ones)
    scale = fit_scale(centred_true, centred @ R.T, ones)
    t_s = estimate.t_s[close]

    def base_track(offset_s: float) -> tuple[Array, Array]:
        before, here, after = (
            positions_at(t_s + offset_s + side, truth.t_s, truth.Ts[:, :3, 3])[0] for side in (-0.02, 0.0, 0.02)
        )
        return here, (after - before) / 0.04

    fit = fit_chord_rotation(scale * seen, base_track, np.diff(arc_lengths(true)), R, 0.0, 0.25)
    return Alignment(
        n=len(seen),
        ate_m=_ate(true, scale * seen @ R.T),
        evo_ate_m=_evo_ate(seen, true, with_scale=True),
        rigid_ate_m=_ate(true, seen @ R.T),
        evo_rigid_ate_m=_evo_ate(seen, true, with_scale=False),
        chords_ate_m=_ate(true, fit.scale * scale * seen @ fit.R_base_vo.T),
        chords_turned_deg=float(np.rad2deg(geodesic_angle(R, fit.R_base_vo))),
    )


def _ate(true: Array, turned: Array) -> float:
    misses = true - turned
    return float(np.sqrt(np.mean(np.sum((misses - misses.mean(axis=0)) ** 2, axis=1))))


def _evo_ate(seen: Array, true: Array, with_scale: bool) -> float | None:
    try:
        from evo.core.geometry import umeyama_alignment  # pyright: ignore[reportMissingImports]
    except ImportError:
        return None
    R, t, scale = umeyama_alignment(seen.T, true.T, with_scale)
    return float(np.sqrt(np.mean(np.sum((true - (scale * seen @ R.T + t)) ** 2, axis=1))))
