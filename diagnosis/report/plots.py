"""The plots of the page, cell by cell."""

from collections.abc import Sequence
from html import escape

import numpy as np

from diagnosis.report.curves import CellCurves, Replayed, Residuals
from diagnosis.report.svg import DOTS, Line, autocorrelation, chart, histogram
from machine.rotations import Array


def plots(curves: Sequence[CellCurves]) -> str:
    """One block a cell; the first open, the others folded away."""
    blocks = [_block(curve, number == 0) for number, curve in enumerate(curves)]
    return "".join(blocks)


def _block(curves: CellCurves, is_open: bool) -> str:
    named = curves.named.replace("_", " ") or "no effect named"
    body = (_replayed(curves.replayed, bool(curves.named)) if curves.replayed is not None else "") + _residuals(
        curves.residuals
    )
    state = " open" if is_open else ""
    return f"<details{state}><summary>{escape(curves.label)}: {escape(named)}</summary>{body}</details>"


def _replayed(replayed: Replayed, explained: bool) -> str:
    lines = [
        Line("measured", "measured", replayed.t_s, replayed.measured),
        Line("nominal model", "before", replayed.t_s, replayed.nominal),
    ]
    apart = [Line("measured less nominal", "before", replayed.t_s, replayed.measured - replayed.nominal)]
    if explained:
        lines.append(Line("nominal with the effects", "after", replayed.t_s, replayed.explained))
        apart.append(
            Line(
                "measured less nominal with the effects", "after", replayed.t_s, replayed.measured - replayed.explained
            )
        )
    where = f"joint {replayed.joint}, trajectory “{replayed.kind}”"
    held = " The numbers were fitted without trajectories of this kind." if explained else ""
    unit = f"{replayed.signal} [{replayed.unit}]"
    return (
        f"<h3>{escape(where)}</h3><p>Replayed from the measured input of this stage.{held}</p>"
        + chart(lines, "time [s]", unit, f"{replayed.signal} of {where}: measured, nominal, with the effects")
        + chart(apart, "time [s]", f"difference [{replayed.unit}]", f"difference of {where}", symmetric=True)
    )


def _residuals(residuals: Residuals) -> str:
    t = residuals.t_s - residuals.t_s[0] if len(residuals.t_s) else residuals.t_s
    together = bool((np.diff(residuals.t_s) == 0.0).any())  # several at an instant: no line leads from one to the next
    along = "pose" if together and bool((residuals.t_s == np.round(residuals.t_s)).all()) else "time [s]"
    shown = f" {DOTS}" if together else ""
    over_time = [
        Line("before", f"before{shown}", t, residuals.before),
        Line("after", f"after{shown}", t, residuals.after),
    ]
    lags = np.arange(1, 41, dtype=float)
    limit = 1.96 / np.sqrt(max(1, len(residuals.before)))
    correlated = [
        Line("before", "before", lags, autocorrelation(residuals.before, residuals.series)),
        Line("after", "after", lags, autocorrelation(residuals.after, residuals.series)),
        Line("95 % of pure noise", "floor", lags, _constant(lags, limit)),
        Line("", "floor", lags, _constant(lags, -limit)),
    ]
    return (
        "<h3>What is left, in noise floors, on held-out data</h3>"
        + chart(over_time, along, "residual [floors]", f"residual over {along}, before and after", symmetric=True)
        + histogram(residuals.before, residuals.after, "residual [noise floors]", "distribution of the residual")
        + chart(correlated, "lag", "autocorrelation", "autocorrelation of the residual")
    )


def _constant(x: Array, value: float) -> Array:
    return np.full(len(x), value)
