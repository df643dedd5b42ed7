"""Small plots as inline SVG: no script, no file next to the page, colours from the page's own style sheet."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

from diagnosis.report.html import wrap_scrollable
from machine.rotations import Array

WIDTH, HEIGHT = 720, 210
LEFT, RIGHT, TOP, BOTTOM = 66, 10, 10, 40
PLOTTED_POINTS_MAX = 700
AXIS_TICKS = 5
DOTS_CSS_CLASS = "dots"


@dataclass(frozen=True, slots=True)
class CurveLine:
    """One line (m,) over x (m,). `css_class`: gives it its colour and dashes; with DOTS_CSS_CLASS: points."""

    label: str
    css_class: str
    x: Array
    y: Array


def chart(lines: Sequence[CurveLine], x_label: str, y_label: str, title: str, symmetric: bool = False) -> str:
    """Lines over a common x, with axes, ticks and a legend; NaN breaks a line."""
    shown = [_thin_line(line) for line in lines if len(line.x)]
    if not shown:
        return ""
    x_range = _axis_range(np.concatenate([line.x for line in shown]), False)
    y_range = _axis_range(np.concatenate([line.y for line in shown]), symmetric)
    frame = _Frame(x_range, y_range)
    body = [_axes_svg(frame, x_label, y_label)]
    body += [f'<path class="{line.css_class}" d="{_svg_path_data(frame, line)}"/>' for line in shown]
    return _svg_element("".join(body), title) + _legend_html(shown)


def histogram(before: Array, after: Array, unit: str, title: str) -> str:
    """Two distributions over common bins, as steps; what lies beyond the outer bins is counted in them."""
    edge = float(np.quantile(np.abs(np.concatenate([before, after])), 0.995)) or 1.0
    edges = np.linspace(-edge, edge, 61)
    lines = [
        CurveLine("before", "before", *_histogram_outline(edges, before)),
        CurveLine("after", "after", *_histogram_outline(edges, after)),
        CurveLine("noise alone", "floor", *_normal_bin_shares(edges)),
    ]
    return chart(lines, unit, "share per bin", title)


def bar(fraction: float, css: str = "bar") -> str:
    """A horizontal bar of a share 0 .. 1 for a table's cell."""
    width = 160 * min(max(fraction, 0.0), 1.0)
    return (
        f'<svg class="inline" width="164" height="14" aria-hidden="true"><rect class="track" width="160" height="12"/>'
        f'<rect class="{css}" width="{width:.1f}" height="12"/></svg>'
    )


def autocorrelation(values: Array, series: NDArray[np.int64], lags: int = 40) -> Array:
    """Of residuals (m,), lags 1 .. `lags`, within each series, pooled; zeros where nothing varies or all are short."""
    total, power = np.zeros(lags), 0.0
    for number in np.unique(series):
        v = values[series == number]
        if len(v) <= lags:
            continue
        v = v - v.mean()
        power += float(v @ v)
        total += np.array([float(v[k:] @ v[:-k]) for k in range(1, lags + 1)])
    return total / power if power > 0.0 else total


@dataclass(frozen=True, slots=True)
class _Frame:
    x_range: tuple[float, float]
    y_range: tuple[float, float]

    def px(self, x: Array) -> Array:
        span = self.x_range[1] - self.x_range[0]
        return LEFT + (x - self.x_range[0]) / span * (WIDTH - LEFT - RIGHT)

    def py(self, y: Array) -> Array:
        span = self.y_range[1] - self.y_range[0]
        return HEIGHT - BOTTOM - (y - self.y_range[0]) / span * (HEIGHT - TOP - BOTTOM)


def _axis_range(values: Array, symmetric: bool) -> tuple[float, float]:
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    if symmetric:
        high = max(abs(low), abs(high))
        low = -high
    if high - low < 1e-12 * max(1.0, abs(high)):
        low, high = low - 0.5, high + 0.5
    return low, high


def _thin_line(line: CurveLine) -> CurveLine:
    """At most 700 points that keep each stretch's extremes."""
    if len(line.x) <= PLOTTED_POINTS_MAX:
        return line
    kept: list[int] = []
    for cut in np.array_split(np.arange(len(line.x)), PLOTTED_POINTS_MAX // 2):
        values = np.nan_to_num(line.y[cut], nan=0.0)
        kept += sorted({int(cut[np.argmin(values)]), int(cut[np.argmax(values)])})
    return CurveLine(line.label, line.css_class, line.x[kept], line.y[kept])


def _svg_path_data(frame: _Frame, line: CurveLine) -> str:
    xs, ys = frame.px(line.x), frame.py(line.y)
    if DOTS_CSS_CLASS in line.css_class:
        return "".join(f"M{x:.1f} {y:.1f}h0" for x, y in zip(xs, ys, strict=True) if np.isfinite(y))
    pieces, pen = [], "M"
    for x, y in zip(xs, ys, strict=True):
        if not np.isfinite(y):
            pen = "M"
            continue
        pieces.append(f"{pen}{x:.1f} {y:.1f}")
        pen = "L"
    return "".join(pieces)


def _axes_svg(frame: _Frame, x_label: str, y_label: str) -> str:
    base, right = HEIGHT - BOTTOM, WIDTH - RIGHT
    out = [f'<rect class="frame" x="{LEFT}" y="{TOP}" width="{right - LEFT}" height="{base - TOP}"/>']
    for value in _tick_values(frame.x_range):
        x = float(frame.px(np.array([value]))[0])
        out.append(f'<text x="{x:.1f}" y="{base + 15}" text-anchor="middle">{_tick_label(value, frame.x_range)}</text>')
    for value in _tick_values(frame.y_range):
        y = float(frame.py(np.array([value]))[0])
        out.append(f'<line class="grid" x1="{LEFT}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}"/>')
        out.append(f'<text x="{LEFT - 5}" y="{y + 4:.1f}" text-anchor="end">{_tick_label(value, frame.y_range)}</text>')
    middle = (LEFT + right) / 2
    out.append(f'<text x="{middle:.0f}" y="{HEIGHT - 6}" text-anchor="middle">{escape(x_label)}</text>')
    turned = f'transform="translate(13 {(TOP + base) / 2:.0f}) rotate(-90)"'
    out.append(f'<text {turned} text-anchor="middle">{escape(y_label)}</text>')
    return "".join(out)


def _tick_values(limits: tuple[float, float]) -> list[float]:
    """Round numbers inside the limits."""
    span = limits[1] - limits[0]
    raw = span / AXIS_TICKS
    power = 10.0 ** np.floor(np.log10(raw))
    step = float(power * min((m for m in (1.0, 2.0, 5.0, 10.0) if m * power >= raw), default=10.0))
    first = np.ceil(limits[0] / step)
    return [float(k * step) for k in np.arange(first, np.floor(limits[1] / step) + 1)]


def _tick_label(value: float, limits: tuple[float, float]) -> str:
    tiny = 1e-9 * max(abs(limits[0]), abs(limits[1]))
    return "0" if abs(value) < tiny else f"{value:.4g}"


def _histogram_outline(edges: Array, values: Array) -> tuple[Array, Array]:
    counts = np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0] / max(1, len(values))
    return np.repeat(edges, 2)[1:-1], np.repeat(counts, 2)


def _normal_bin_shares(edges: Array) -> tuple[Array, Array]:
    """The unit normal's share per bin: what whitened residuals are if only noise is left."""
    middle = 0.5 * (edges[1:] + edges[:-1])
    share = np.exp(-0.5 * middle**2) / np.sqrt(2.0 * np.pi) * (edges[1] - edges[0])
    return middle, share


def _legend_html(lines: Sequence[CurveLine]) -> str:
    keys = "".join(
        f'<span><svg width="26" height="10" aria-hidden="true"><path class="{line.css_class}" d="M1 5L25 5"/></svg> '
        f"{escape(line.label)}</span>"
        for line in lines
        if line.label
    )
    return f'<p class="legend">{keys}</p>'


def _svg_element(body: str, title: str) -> str:
    size = f'viewBox="0 0 {WIDTH} {HEIGHT}"'
    return wrap_scrollable(f'<svg class="plot" {size} role="img" aria-label="{escape(title)}">{body}</svg>')
