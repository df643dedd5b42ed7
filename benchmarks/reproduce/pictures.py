"""Figures 5 to 9 of the paper from one of our own runs, the spread of Tables 2 and 4. Matplotlib is a bench extra."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.reproduce.cases import Case, FastRun
from benchmarks.reproduce.error_series import (
    ErrorSeries,
    encoder_path,
    encoder_pose,
    error_series,
    look_times_s,
)
from benchmarks.reproduce.paper_tables import STAND_OFF_MM, TABLE_2, TABLE_4, TOLERANCE_MM
from machine.rotations import Array
from server.calibration.line_equation import circle_points

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AXIS_COLOURS = ("#c0392b", "#1e8449", "#1f618d")
GREY = "#7f8c8d"
PAPER, OURS = "#d35400", "#2e4053"


def new_figure(width_in: float = 8.0, height_in: float = 3.6) -> "Figure":
    """An empty figure without a window."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), layout="constrained")


def save(figure: "Figure", folder: Path, name: str) -> Path:
    """PNG (for the report) and SVG beside it. Returns the PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"{name}.svg")
    figure.savefig(folder / f"{name}.png", dpi=110)
    return folder / f"{name}.png"


def figure_5(run: FastRun) -> "Figure":
    """Orientation errors before and after the orientation adjustment."""
    looks = look_times_s(run)
    series = error_series(run, 0.0, looks[1] + 4.0)
    return _over_time(replace(series, inputs_s=series.inputs_s[:1]), series.euler_deg, "orientation error [deg]")


def figure_7(run: FastRun) -> "Figure":
    """Position errors while the circle and the line-equation move are driven."""
    series = error_series(run, look_times_s(run)[1], look_times_s(run)[2] + 3.0)
    return _over_time(replace(series, inputs_s=()), series.camera_mm, "OOI minus tool [mm]")


def figure_9(run: FastRun) -> "Figure":
    """Position errors over the two moves of the trajectory matching."""
    looks = look_times_s(run)
    series = error_series(run, looks[2] - 3.0, looks[-1] + 3.0)
    figure = _over_time(series, series.camera_mm, "OOI minus tool [mm]")
    axes = figure.axes[0]
    axes.axhline(STAND_OFF_MM, color=GREY, linewidth=0.8, linestyle=":")
    axes.text(0.2, STAND_OFF_MM + 8.0, "stand-off 100 mm", color=GREY, fontsize=8)
    return figure


def _over_time(series: ErrorSeries, values: Array, label: str) -> "Figure":
    figure = new_figure()
    axes = figure.add_subplot()
    for k, name in enumerate("XYZ"):
        axes.plot(series.t_s, values[:, k], ".-", color=AXIS_COLOURS[k], markersize=2.5, linewidth=0.8, label=name)
    axes.axhline(0.0, color="black", linewidth=0.6)
    for number, t_s in enumerate(series.inputs_s, start=1):
        axes.axvline(t_s, color=GREY, linestyle="--", linewidth=0.9, label="control input" if number == 1 else None)
    axes.set(xlabel="time [s]", ylabel=label)
    axes.legend(ncols=4, fontsize=8, loc="upper right")
    return figure


def figure_6(run: FastRun) -> "Figure":
    """The circle as planned and driven, and the move to the reference."""
    start_s = look_times_s(run)[1]
    planned, driven = circle_points(encoder_pose(run, start_s)), encoder_path(run, start_s)
    figure = new_figure(9.0, 4.0)
    _flat_and_side(figure, [("reference: centre, 16 points, centre", planned, "black", "o-"),
                            ("driven (encoders), then the move", driven, AXIS_COLOURS[0], "-")])  # fmt: skip
    return figure


def figure_8(run: FastRun) -> "Figure":
    """Reference path, encoders and matched odometry."""
    if run.sets is None or run.reference is None:
        raise ValueError(f"seed {run.case.seed}: {run.case.reason}; choose another seed")
    figure = new_figure(9.0, 4.0)
    _flat_and_side(figure, [("reference", run.reference, AXIS_COLOURS[1], "-"),
                            ("encoder-based TCP", run.sets.encoder, "black", "-"),
                            ("odometry after the match", run.sets.matched, AXIS_COLOURS[0], "-")])  # fmt: skip
    return figure


def _flat_and_side(figure: "Figure", paths: Sequence[tuple[str, Array, str, str]]) -> None:
    """A path in the two planes of base axes that show most of it, in millimetres from its start."""
    origin = paths[0][1][0]
    spread = np.ptp(paths[0][1], axis=0)
    last, second, first = np.argsort(spread).tolist()
    for place, (a, b) in enumerate(((first, second), (first, last)), start=1):
        axes: Any = figure.add_subplot(1, 2, place)
        for name, points, colour, style in paths:
            shown = 1e3 * (points - origin)
            axes.plot(shown[:, a], shown[:, b], style, color=colour, linewidth=1.0, markersize=3.0, label=name)
        axes.set(xlabel=f"base {'xyz'[a]} [mm]", ylabel=f"base {'xyz'[b]} [mm]")
        if place == 1:
            axes.set_aspect("equal", adjustable="datalim")
            axes.legend(fontsize=7, loc="best")


def spread_of_table_2(cases: dict[str, list[Case]]) -> "Figure":
    """Where each machine's tool ends in X and Y (absolute), ours beside the paper's nine rows."""
    kinds = [("paper servo", "as the paper: nearest point"), ("fit", "improved: fit over all looks")]
    figure = new_figure(9.0, 4.0)
    for place, (kind, title) in enumerate(kinds, start=1):
        axes: Any = figure.add_subplot(1, 2, place)
        ends = np.abs(
            [step.camera_image_mm for case in cases.get(kind, []) for step in case.steps if step.name == "move"]
        )
        if len(ends):
            axes.plot(
                ends[:, 0], ends[:, 1], ".", color=OURS, markersize=3.0, alpha=0.4, label=f"ours, N = {len(ends)}"
            )
        rows = np.array([row.position_mm for row in TABLE_2], dtype=float)
        axes.plot(rows[:, 0], rows[:, 1], "D", color=PAPER, markersize=6.0, label="the paper's nine rows")
        axes.set(xlabel="|e_X| [mm]", ylabel="|e_Y| [mm]", title=title, xlim=(0, 120), ylim=(0, 120))
        axes.legend(fontsize=8)
    return figure


def spread_of_table_4(cases: list[Case]) -> "Figure":
    """Histograms of the errors after both control inputs, the paper's ten rows as ticks."""
    figure = new_figure(10.0, 5.0)
    for row, name in enumerate(("move 1", "move 2")):
        ends = np.abs([step.camera_image_mm for case in cases for step in case.steps if step.name == name]).reshape(
            -1, 3
        )
        paper = np.array([each.first_mm if row == 0 else each.second_mm for each in TABLE_4])
        for k, axis in enumerate("XYZ"):
            axes: Any = figure.add_subplot(2, 3, 3 * row + k + 1)
            axes.hist(ends[:, k], bins=40, color=OURS, alpha=0.75, density=True, label=f"ours, N = {len(ends)}")
            height = axes.get_ylim()[1]
            axes.vlines(paper[:, k], 0.0, 0.25 * height, color=PAPER, linewidth=2.0, label="the paper's ten rows")
            if axis != "Z" and row == 1:
                axes.axvline(TOLERANCE_MM, color=GREY, linestyle="--", linewidth=0.9, label="tolerance 5 mm")
            axes.set(title=f"|e_{axis}| after input {row + 1} [mm]")
            axes.set_yticks([])
            if k == 0:
                axes.legend(fontsize=7)
    return figure


def agreement_picture(distributions: dict[str, dict[str, dict[str, list[float]]]]) -> "Figure":
    """Cumulative distributions of rendered and fast errors over each other, one panel per quantity and axis."""
    names = list(distributions)
    figure = new_figure(13.0, 2.1 * len(names))
    for row, name in enumerate(names):
        for column, (axis, both) in enumerate(distributions[name].items()):
            axes: Any = figure.add_subplot(len(names), 6, 6 * row + column + 1)
            for which, colour, style in (("rendered", PAPER, "-"), ("fast", OURS, "--")):
                values = np.sort(both[which])
                axes.plot(values, np.linspace(0.0, 1.0, len(values)), style, color=colour, linewidth=1.3, label=which)
            low, high = np.percentile(np.concatenate([both["rendered"], both["fast"]]), [1.0, 99.0])
            axes.set_xlim(low, high)
            unit = "deg" if column < 3 else "mm"
            axes.set_title(f"{name}: {axis} [{unit}]", fontsize=8)
            axes.tick_params(labelsize=7)
            if row == 0 and column == 0:
                axes.legend(fontsize=7)
    return figure
