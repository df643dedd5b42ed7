"""`longreach reproduce noise`: render looks and odometry, fit the fast world's noise, show that the two err alike."""

import json
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks.reproduce.noise_agreement import Compared, compare, fit_all
from benchmarks.reproduce.noise_fit import AXES
from benchmarks.reproduce.noise_gather import FRAMES, SEED_FIRST, STANDPOINTS, gather_looks, gather_paths, preset_of
from benchmarks.reproduce.noise_model import NoiseModel, fitted_noise
from benchmarks.reproduce.rendered_looks import JPEG_QUALITY
from benchmarks.reproduce.rendered_paths import one_thread
from benchmarks.saved_lines import Line
from server.settings import read_machine

AGREEMENT_FILE = "agreement.json"
SCALES = (np.rad2deg(1.0),) * 3 + (1e3,) * 3
UNITS = ("deg",) * 3 + ("mm",) * 3


def run_noise(n: int, n_paths: int, folder: Path, console: Console) -> tuple[NoiseModel, list[Compared]]:
    """Gather (or resume), compare by halves, fit on everything, write `noise_fitted.json` and `agreement.json`."""
    one_thread()
    machine = read_machine("hiab033")
    seeds = range(SEED_FIRST, SEED_FIRST + n)
    looks = gather_looks(machine, seeds, folder, console)
    paths = gather_paths(machine, seeds[:n_paths], fitted_noise(), folder, console)
    compared = compare(looks, paths, machine)
    model = fit_all(looks, paths, machine, source_text(seeds, len(paths), len(looks)))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "noise_fitted.json").write_text(model.to_json() + "\n", encoding="utf-8")
    found = {"rows": agreement_lines(compared), "distributions": distributions(compared)}
    (folder / AGREEMENT_FILE).write_text(json.dumps(found), encoding="utf-8")
    return model, compared


def source_text(seeds: range, n_paths: int, n_looks: int) -> str:
    """Where a fit comes from, for its file."""
    n_paper = sum(preset_of(seed) == "paper" for seed in seeds)
    return (
        f"{len(seeds)} rendered worlds ({len(seeds) - n_paper} realistic, {n_paper} paper; seeds {seeds[0]} to "
        f"{seeds[-1]}), {STANDPOINTS} standpoints, {FRAMES} pairs each, JPEG {JPEG_QUALITY}, {n_looks} looks; "
        f"odometry: {n_paths} rendered calibration paths of the same worlds, beside their own lens (fast_lens)"
    )


def agreement_lines(compared: list[Compared]) -> list[Line]:
    """The table as data, in degrees and millimetres."""
    lines = []
    for one in compared:
        for row, scale, unit in zip(one.rows, SCALES, UNITS, strict=True):
            lines.append(
                {
                    "name": one.name,
                    "axis": row.axis,
                    "unit": unit,
                    "n": row.n,
                    "sd_rendered": row.sd_rendered * scale,
                    "sd_ratio": row.sd_ratio,
                    "mean_rendered": row.mean_rendered * scale,
                    "mean_fast": row.mean_fast * scale,
                    "ks": row.ks,
                    "p": row.p,
                }
            )
    return lines


def distributions(compared: list[Compared], n_max: int = 400) -> dict[str, dict[str, dict[str, list[float]]]]:
    """Sorted errors of both by quantity and axis (up to n_max quantiles), for the picture. Degrees and millimetres."""
    found: dict[str, dict[str, dict[str, list[float]]]] = {}
    for one in compared:
        axes = found[one.name] = {}
        for k, (axis, scale) in enumerate(zip(AXES, SCALES, strict=True)):
            axes[axis] = {
                "rendered": _quantiles(one.rendered[:, k] * scale, n_max),
                "fast": _quantiles(one.fast[:, k] * scale, n_max),
            }
    return found


def _quantiles(values: np.ndarray, n_max: int) -> list[float]:
    if len(values) <= n_max:
        return np.sort(values).round(6).tolist()
    return np.quantile(values, np.linspace(0.0, 1.0, n_max)).round(6).tolist()
