"""The plots of the page, cell by cell."""

from collections.abc import Sequence
from html import escape

import numpy as np

from diagnosis.report.curves import CellCurves, CellResiduals, ReplayedTrajectory
from diagnosis.report.svg import DOTS_CSS_CLASS, CurveLine, autocorrelation, chart, histogram
from machine.rotations import Array


def cell_plots(curves: Sequence[CellCurves]) -> str:
    """One block a cell; the first open, the others folded away."""
    blocks = [_cell_plots(curve, number == 0) for number, curve in enumerate(curves)]
    return "".join(blocks)


def _cell_plots(curves: CellCurves, is_open: bool) -> str:
    named = curves.named_effects.replace("_", " ") or "no effect named"
    body = (
        _trajectory_plots(curves.replayed_trajectory, bool(curves.named_effects))
        if curves.replayed_trajectory is not None
        else ""
    ) + _residual_plots(curves.residuals)
    state = " open" if is_open else ""
    return f"<details{state}><summary>{escape(curves.cell_label)}: {escape(named)}</summary>{body}</details>"


def _trajectory_plots(replayed: ReplayedTrajectory, explained: bool) -> str:
    lines = [
        CurveLine("measured", "measured", replayed.t_s, replayed.measured_output),
        CurveLine("nominal model", "before", replayed.t_s, replayed.nominal_output),
    ]
    apart = [
        CurveLine("measured less nominal", "before", replayed.t_s, replayed.measured_output - replayed.nominal_output)
    ]
    if explained:
        lines.append(CurveLine("nominal with the effects", "after", replayed.t_s, replayed.output_with_effects))
        apart.append(
            CurveLine(
                "measured less nominal with the effects",
                "after",
                replayed.t_s,
                replayed.measured_output - replayed.output_with_effects,
            )
        )
    where = f"joint {replayed.joint}, trajectory “{replayed.segment_kind}”"
    held = " The numbers were fitted without trajectories of this kind." if explained else ""
    unit = f"{replayed.signal_label} [{replayed.unit}]"
    return (
        f"<h3>{escape(where)}</h3><p>Replayed from the measured input of this stage.{held}</p>"
        + chart(lines, "time [s]", unit, f"{replayed.signal_label} of {where}: measured, nominal, with the effects")
        + chart(apart, "time [s]", f"difference [{replayed.unit}]", f"difference of {where}", symmetric=True)
    )


def _residual_plots(residuals: CellResiduals) -> str:
    t = residuals.t_s - residuals.t_s[0] if len(residuals.t_s) else residuals.t_s
    together = bool((np.diff(residuals.t_s) == 0.0).any())  # several at an instant: no line leads from one to the next
    along = "pose" if together and bool((residuals.t_s == np.round(residuals.t_s)).all()) else "time [s]"
    shown = f" {DOTS_CSS_CLASS}" if together else ""
    over_time = [
        CurveLine("before", f"before{shown}", t, residuals.residual_without_effects),
        CurveLine("after", f"after{shown}", t, residuals.residual_with_effects),
    ]
    lags = np.arange(1, 41, dtype=float)
    limit = 1.96 / np.sqrt(max(1, len(residuals.residual_without_effects)))
    correlated = [
        CurveLine(
            "before", "before", lags, autocorrelation(residuals.residual_without_effects, residuals.series_index)
        ),
        CurveLine("after", "after", lags, autocorrelation(residuals.residual_with_effects, residuals.series_index)),
        CurveLine("95 % of pure noise", "floor", lags, _constant_array(lags, limit)),
        CurveLine("", "floor", lags, _constant_array(lags, -limit)),
    ]
    return (
        "<h3>What is left, in noise floors, on held-out data</h3>"
        + chart(over_time, along, "residual [floors]", f"residual over {along}, before and after", symmetric=True)
        + histogram(
            residuals.residual_without_effects,
            residuals.residual_with_effects,
            "residual [noise floors]",
            "distribution of the residual",
        )
        + chart(correlated, "lag", "autocorrelation", "autocorrelation of the residual")
    )


def _constant_array(x: Array, value: float) -> Array:
    return np.full(len(x), value)
