"""The kinhec generator's smoke tier: our hand-eye errors against exact truth, beside its own solvers'."""

import contextlib
import importlib.util
import io
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from server.calibration.hand_eye import HandEyeEstimate, estimate_hand_eye, solve_ax_yb

TRACKS = ("temporal", "outliers", "robot_error")


@dataclass(frozen=True, slots=True)
class SequenceResult:
    """Ours on one sequence against the truth; errors None when refused. `chi2`: of X over its covariance, 6 degrees."""

    track: str
    sequence: str
    rotation_deg: float | None
    translation_mm: float | None
    chi2: float | None
    offset_error_ms: float
    seconds: float
    reason: str


@dataclass(frozen=True, slots=True)
class TrackResult:
    """One track: medians of ours, and of kinhec's best solver in rotation and in translation."""

    track: str
    n: int
    refused: int
    rotation_deg: float
    translation_mm: float
    best_rotation: tuple[str, float]
    best_translation: tuple[str, float]


def kinhec_available() -> bool:
    """Whether the optional package is installed."""
    return importlib.util.find_spec("kinhec") is not None


def generate(folder: Path, tier: str = "smoke") -> None:
    """Write the tier's sequences, unless they are there already."""
    from kinhec.cli import main  # pyright: ignore[reportMissingImports]

    if not (folder / "sequences.parquet").exists():
        with contextlib.redirect_stdout(io.StringIO()):
            main(["generate", "--tier", tier, "--out", str(folder), "--work-dir", str(folder / "work")])


def run_track(folder: Path, track: str) -> tuple[TrackResult, list[SequenceResult]]:
    """Ours and all of kinhec's solvers on one track; the clock offset is estimated by either, never given."""
    from kinhec.benchmark import run_benchmark  # pyright: ignore[reportMissingImports]
    from kinhec.io import _load_from_row, load_manifest  # pyright: ignore[reportMissingImports]

    theirs = run_benchmark(folder, out_dir=folder / "benchmarks" / track, tracks=[track], progress=False)
    asynchronous = bool((theirs["eval_sync"] == "estimated").any())
    theirs = theirs[theirs["ok"] & (theirs["eval_sync"] == ("estimated" if asynchronous else "oracle"))]
    rows = [row.to_dict() for _, row in load_manifest(folder, [track]).iterrows()]
    ours = [_judge(track, _load_from_row(folder, row)) for row in rows]
    by_solver = theirs.groupby("solver")[["X_rot_err_deg", "X_trans_err_mm"]].median()
    degrees = [one.rotation_deg for one in ours if one.rotation_deg is not None]
    millimetres = [one.translation_mm for one in ours if one.translation_mm is not None]
    return TrackResult(
        track=track,
        n=len(ours),
        refused=len(ours) - len(degrees),
        rotation_deg=float(np.median(degrees)) if degrees else float("nan"),
        translation_mm=float(np.median(millimetres)) if millimetres else float("nan"),
        best_rotation=_least(by_solver["X_rot_err_deg"]),
        best_translation=_least(by_solver["X_trans_err_mm"]),
    ), ours


def _least(column: Any) -> tuple[str, float]:
    return str(column.idxmin()), float(column.min())


def _judge(track: str, sequence: Any) -> SequenceResult:
    from kinhec.metrics import calibration_errors  # pyright: ignore[reportMissingImports]

    started = time.perf_counter()
    found = _ours(sequence)
    seconds = time.perf_counter() - started
    errors = None if found.T_hand_cam is None else calibration_errors(found.T_hand_cam, sequence.X)
    return SequenceResult(
        track=track,
        sequence=str(sequence.id),
        rotation_deg=None if errors is None else float(errors["X_rot_err_deg"]),
        translation_mm=None if errors is None else float(errors["X_trans_err_mm"]),
        chi2=_chi2(found, sequence.X),
        offset_error_ms=1e3 * (found.time_offset_s + (0.0 if sequence.synchronous else sequence.time_offset)),
        seconds=seconds,
        reason=found.reason,
    )


def _ours(sequence: Any) -> HandEyeEstimate:
    if sequence.synchronous:
        As, Bs = sequence.axyb_poses()
        return solve_ax_yb(As, Bs)
    robot, camera = sequence.robot, sequence.camera
    return estimate_hand_eye(robot.t, robot.T_base_ee_meas, camera.t, camera.T_cam_target_meas)


def _chi2(found: HandEyeEstimate, X_true: Any) -> float | None:
    from scipy.spatial.transform import Rotation

    if found.T_hand_cam is None or found.covariance is None:
        return None
    turned = Rotation.from_matrix(X_true[:3, :3] @ found.T_hand_cam[:3, :3].T).as_rotvec()
    error = np.concatenate((turned, X_true[:3, 3] - found.T_hand_cam[:3, 3]))
    return float(error @ np.linalg.solve(found.covariance[:6, :6], error))
