"""What the paper's camera would have shown over time: errors of single pairs along a fast run (Figures 5, 7, 9)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.reproduce.cases import FastRun
from benchmarks.reproduce.fast_cell import FastCell
from benchmarks.reproduce.true_error import euler_deg
from machine.chain import chain_of
from machine.kinematics import tcp_poses
from machine.rotations import Array
from server.jobs.requests import USABLE_POSE_STATUSES

RATE_HZ = 5.0


@dataclass(frozen=True, slots=True)
class ErrorSeries:
    """Times (n,) [s] from the window's start; OOI minus tool (n, 3) [mm], camera axes; Euler x y z (n, 3) [deg].

    Rows of failed detections are 0, as in the paper's Figure 5. `inputs_s`: when a control input was given.
    """

    t_s: Array
    camera_mm: Array
    euler_deg: Array
    found: NDArray[np.bool_]
    inputs_s: tuple[float, ...]


def cell_of(run: FastRun) -> FastCell:
    """The run's cell.

    Raises: ValueError: the run had no set-up.
    """
    if run.cell is None:
        raise ValueError(f"seed {run.case.seed}: {run.case.reason}; choose another seed")
    return run.cell


def look_times_s(run: FastRun) -> list[float]:
    """When looks were taken [s], in order."""
    return [1e-9 * t_ns for t_ns in sorted(cell_of(run).looks)]


def error_series(run: FastRun, t_from_s: float, t_to_s: float) -> ErrorSeries:
    """Single pairs of the left eye at `RATE_HZ` through a window of the run."""
    cell = cell_of(run)
    trace = cell.machine.trace(t_from_s)
    last = min(t_to_s, float(trace.t_s[-1]))
    picks = np.searchsorted(trace.t_s, np.arange(trace.t_s[0], last, 1.0 / RATE_HZ))
    vectors, turns, found = np.zeros((len(picks), 3)), np.zeros((len(picks), 3)), np.zeros(len(picks), dtype=bool)
    for row, k in enumerate(picks):
        pair = cell.camera.pair(trace.Ts_base_tcp[k], "mono", 0)
        tool, ooi = pair.tool.T_cam_object, pair.ooi.T_cam_object
        if (
            pair.tool.status in USABLE_POSE_STATUSES
            and pair.ooi.status in USABLE_POSE_STATUSES
            and tool is not None
            and ooi is not None
        ):
            vectors[row], turns[row] = 1e3 * (ooi[:3, 3] - tool[:3, 3]), euler_deg(tool[:3, :3], ooi[:3, :3])
            found[row] = True
    inputs = tuple(t - t_from_s for t in look_times_s(run) if t_from_s <= t < last - 1.0)
    return ErrorSeries(trace.t_s[picks] - t_from_s, vectors, turns, found, inputs)


def encoder_path(run: FastRun, t_from_s: float) -> Array:
    """The encoders' TCP (n, 3) [m] from a time on."""
    cell = cell_of(run)
    return tcp_poses(chain_of(cell.world.nominal), cell.machine.trace(t_from_s).q_encoder)[:, :3, 3]


def encoder_pose(run: FastRun, t_s: float) -> Array:
    """The encoders' T_base_tcp (4, 4) at a time."""
    cell = cell_of(run)
    trace = cell.machine.trace(0.0)
    k = int(np.clip(np.searchsorted(trace.t_s, t_s), 0, len(trace.t_s) - 1))
    return tcp_poses(chain_of(cell.world.nominal), trace.q_encoder[k : k + 1])[0]
