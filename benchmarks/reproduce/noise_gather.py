"""Renders what the noise fit needs, world by world, kept as JSON lines: looks, and odometry over driven paths."""

from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.reproduce.fast_machine import QuasiStaticMachine
from benchmarks.reproduce.noise_model import NoiseModel
from benchmarks.reproduce.odometry_fit import OdometryRunPair
from benchmarks.reproduce.rendered_looks import RenderedLook, rendered_looks, standpoints
from benchmarks.reproduce.rendered_paths import NoPathError, RenderedPath, rendered_path
from benchmarks.saved_lines import Line, run_saved
from machine.description import Machine
from machine.rotations import Array
from server.jobs.context import Method
from sim_plc.draw_world import draw_world
from sim_plc.presets import PresetError
from sim_plc.world import World, rng_for

STANDPOINTS = 4
FRAMES = 5
PRESETS = ("realistic", "realistic", "paper")  # in turns
SEED_FIRST = 9001  # machines that no table is made of


def preset_of(seed: int) -> str:
    """Two worlds in three are `realistic`."""
    return PRESETS[seed % len(PRESETS)]


def gather_looks(machine: Machine, seeds: range, folder: Path, console: Console) -> list[RenderedLook]:
    """Looks from `STANDPOINTS` poses of each world."""

    def run(seed: int) -> Line:
        world = _world(machine, seed)
        if world is None:
            return {"looks": []}
        start = QuasiStaticMachine(world).T_base_tcp()
        poses = standpoints(world, start, STANDPOINTS, rng_for(seed, "standpoints"))
        return {"looks": [_look_line(look) for look in rendered_looks(world, poses, FRAMES)]}

    lines = run_saved(folder / "looks.jsonl", seeds, run, console, "rendered looks")
    return [_look(row) for line in lines for row in line["looks"]]


def gather_paths(
    machine: Machine, seeds: range, noise: NoiseModel, folder: Path, console: Console
) -> list[RenderedPath]:
    """Odometry over the calibration path of each world, ours and the paper's in turns."""

    def run(seed: int) -> Line:
        world = _world(machine, seed)
        method: Method = "paper" if preset_of(seed) == "paper" else "ours"
        if world is None:
            return {"path": None, "reason": "no such world"}
        try:
            return {"path": _path_line(rendered_path(world, method, noise))}
        except NoPathError as error:
            return {"path": None, "reason": str(error)}

    lines = run_saved(folder / "paths.jsonl", seeds, run, console, "rendered paths")
    return [_path(line["path"]) for line in lines if line["path"] is not None]


def _world(machine: Machine, seed: int) -> World | None:
    try:
        return draw_world(machine, preset_of(seed), seed)
    except PresetError:
        return None


def _look_line(look: RenderedLook) -> dict[str, Any]:
    return {
        "seed": look.seed,
        "on": look.on,
        "source": look.source,
        "T_base_tcp": look.T_base_tcp.tolist(),
        "T_cam_true": look.T_cam_true.tolist(),
        "T_cam_exact": look.T_cam_exact.tolist(),
        "Ts_cam_measured": look.Ts_cam_measured.tolist(),
        "seen": look.seen,
        "n_other": look.n_other,
    }


def _look(row: dict[str, Any]) -> RenderedLook:
    arrays = {name: np.array(row[name]) for name in ("T_base_tcp", "T_cam_true", "T_cam_exact", "Ts_cam_measured")}
    seen = tuple((int(marker_id), eye) for marker_id, eye in row["seen"])
    return RenderedLook(
        seed=row["seed"], on=row["on"], source=row["source"], seen=seen, n_other=row["n_other"], **arrays
    )


def _path_line(path: RenderedPath) -> dict[str, Any]:
    return {
        "seed": path.seed,
        "method": path.method,
        "Ts_vo_cam": _rows(path.run.Ts_vo_cam),
        "Ts_true": _rows(path.run.Ts_true),
        "rate_hz": path.run.rate_hz,
        "affine": path.affine.tolist(),
        "lost_share": path.lost_share,
    }


def _rows(Ts: Array) -> list[list[float]]:
    """Upper three rows of each pose (n, 12), to 1e-9."""
    return np.round(Ts[:, :3].reshape(-1, 12), 9).tolist()


def _poses(rows: list[list[float]]) -> Array:
    Ts = np.tile(np.eye(4), (len(rows), 1, 1))
    Ts[:, :3] = np.array(rows).reshape(-1, 3, 4)
    return Ts


def _path(row: dict[str, Any]) -> RenderedPath:
    run = OdometryRunPair(_poses(row["Ts_vo_cam"]), _poses(row["Ts_true"]), row["rate_hz"])
    return RenderedPath(row["seed"], row["method"], run, np.array(row["affine"]), row["lost_share"])
