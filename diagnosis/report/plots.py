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


def _block(one: CellCurves, is_open: bool) -> str:
    named = one.named.replace("_", " ") or "no effect named"
    body = (_replayed(one.replayed, bool(one.named)) if one.replayed is not None else "") + _residuals(one.residuals)
    state = " open" if is_open else ""
    return f"<details{state}><summary>{escape(one.label)}: {escape(named)}</summary>{body}</details>"


def _replayed(one: Replayed, explained: bool) -> str:
    lines = [Line("measured", "measured", one.t_s, one.measured), Line("nominal model", "before", one.t_s, one.nominal)]
    apart = [Line("measured less nominal", "before", one.t_s, one.measured - one.nominal)]
    if explained:
        lines.append(Line("nominal with the effects", "after", one.t_s, one.explained))
        apart.append(Line("measured less nominal with the effects", "after", one.t_s, one.measured - one.explained))
    where = f"joint {one.joint}, trajectory “{one.kind}”"
    held = " The numbers were fitted without trajectories of this kind." if explained else ""
    unit = f"{one.signal} [{one.unit}]"
    return (
        f"<h3>{escape(where)}</h3><p>Replayed from the measured input of this stage.{held}</p>"
        + chart(lines, "time [s]", unit, f"{one.signal} of {where}: measured, nominal, with the effects")
        + chart(apart, "time [s]", f"difference [{one.unit}]", f"difference of {where}", symmetric=True)
    )


def _residuals(one: Residuals) -> str:
    t = one.t_s - one.t_s[0] if len(one.t_s) else one.t_s
    together = bool((np.diff(one.t_s) == 0.0).any())  # several at an instant: no line leads from one to the next
    along = "pose" if together and bool((one.t_s == np.round(one.t_s)).all()) else "time [s]"
    shown = f" {DOTS}" if together else ""
    over_time = [Line("before", f"before{shown}", t, one.before), Line("after", f"after{shown}", t, one.after)]
    lags = np.arange(1, 41, dtype=float)
    limit = 1.96 / np.sqrt(max(1, len(one.before)))
    correlated = [
        Line("before", "before", lags, autocorrelation(one.before, one.series)),
        Line("after", "after", lags, autocorrelation(one.after, one.series)),
        Line("95 % of pure noise", "floor", lags, _constant(lags, limit)),
        Line("", "floor", lags, _constant(lags, -limit)),
    ]
    return (
        "<h3>What is left, in noise floors, on held-out data</h3>"
        + chart(over_time, along, "residual [floors]", f"residual over {along}, before and after", symmetric=True)
        + histogram(one.before, one.after, "residual [noise floors]", "distribution of the residual")
        + chart(correlated, "lag", "autocorrelation", "autocorrelation of the residual")
    )


def _constant(x: Array, value: float) -> Array:
    return np.full(len(x), value)
