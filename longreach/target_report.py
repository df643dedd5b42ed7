"""Result of teaching: a comparison with the present layout, machine-file lines, and JSON with the covariance."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.table import Table

from machine.description import Marker
from machine.rotations import rotvec_from_rotation
from server.vision.teach_contracts import TaughtLayout, TaughtMarker, angle_sigma_rad, position_sigma_m


def layout_table(layout: TaughtLayout, present: Mapping[int, Marker]) -> Table:
    """One row a marker: how far it lies from its present entry, and how well its place is known."""
    table = Table(title="places, against the present ones", title_justify="left")
    for heading in ("id", "dx mm", "dy mm", "dz mm", "turn deg", "+- mm", "+- deg", "views", "rms px"):
        table.add_column(heading, justify="right", no_wrap=True)
    for marker in layout.markers:
        sigmas = f"{1e3 * position_sigma_m(marker):.2f}", f"{np.rad2deg(angle_sigma_rad(marker)):.3f}"
        table.add_row(
            str(marker.marker_id),
            *_marker_shift_row(marker, present.get(marker.marker_id)),
            *sigmas,
            str(marker.n_views),
            f"{marker.residual_rms_px:.3f}",
        )
    return table


def _marker_shift_row(one: TaughtMarker, present: Marker | None) -> tuple[str, str, str, str]:
    """How far a marker lies from its present entry, in the object's axes."""
    if present is None:
        return "new", "", "", ""
    x, y, z = 1e3 * (one.T_on_marker[:3, 3] - present.T_on_marker[:3, 3])
    turn = rotvec_from_rotation(one.T_on_marker[:3, :3] @ present.T_on_marker[:3, :3].T)
    return f"{x:+.2f}", f"{y:+.2f}", f"{z:+.2f}", f"{np.rad2deg(np.linalg.norm(turn)):.2f}"


def sides_table(layout: TaughtLayout) -> Table:
    """One row a marker: its side by the print, by the images alone, and the best of both."""
    table = Table(title="sides", title_justify="left")
    for heading in ("id", "print mm", "images and baseline mm", "both mm"):
        table.add_column(heading, justify="right", no_wrap=True)
    for marker in layout.markers:
        printed = "-" if marker.printed_side_m is None else f"{1e3 * marker.printed_side_m:.2f}"
        images = f"{1e3 * marker.stereo_side_m:.2f} +- {1e3 * marker.stereo_side_sigma_m:.2f}"
        both = f"{1e3 * marker.side_m:.2f} +- {1e3 * marker.side_sigma_m:.2f}"
        table.add_row(str(marker.marker_id), printed, images, both)
    return table


def verdict_text(layout: TaughtLayout) -> str:
    """One honest sentence."""
    angle_deg = np.rad2deg(max(angle_sigma_rad(marker) for marker in layout.markers))
    return (
        f"{len(layout.markers)} markers from {layout.n_views} views, {layout.spread_deg:.0f} deg apart at most; "
        f"residual {layout.residual_rms_px:.3f} px rms. Known to +-{layout.sigma_mm:.2f} mm and +-{angle_deg:.3f} deg "
        f"(one sigma, worst marker and direction). Baseline by print and images {100 * layout.baseline_frac:+.2f} +- "
        f"{100 * layout.baseline_sigma_frac:.2f} % from the camera file's."
    )


def layout_toml(layout: TaughtLayout, on: str) -> str:
    """The [[markers.marker]] entries for the machine file."""
    parts = [
        f"# By `longreach target teach`: {layout.n_views} views, +-{layout.sigma_mm:.2f} mm (one sigma, worst marker)."
    ]
    for marker in layout.markers:
        rows = [", ".join(f"{value:.12f}" for value in row) for row in marker.T_on_marker]
        sigma = f"# +-{1e3 * position_sigma_m(marker):.2f} mm, +-{np.rad2deg(angle_sigma_rad(marker)):.3f} deg"
        parts.append(
            f'[[markers.marker]]\nid = {marker.marker_id}\nside_m = {marker.side_m:.6f}\non = "{on}"\n'
            f"T_on_marker = [{(',' + chr(10) + ' ' * 15).join(rows)}]   {sigma}\n"
        )
    return "\n".join(parts)


def layout_json(layout: TaughtLayout, on: str) -> str:
    """Everything, with the covariance (6, 6) of every marker: rotation vector [rad], translation [m]."""
    content: dict[str, Any] = {
        "status": layout.status.value,
        "reason": layout.reason,
        "on": on,
        "n_views": layout.n_views,
        "spread_deg": _finite_or_none(layout.spread_deg),
        "residual_rms_px": _finite_or_none(layout.residual_rms_px),
        "baseline_frac": _finite_or_none(layout.baseline_frac),
        "baseline_sigma_frac": _finite_or_none(layout.baseline_sigma_frac),
        "notes": list(layout.notes),
        "markers": [_marker_json(marker) for marker in layout.markers],
    }
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def _marker_json(one: TaughtMarker) -> dict[str, Any]:
    return {
        "id": one.marker_id,
        "side_m": one.side_m,
        "side_sigma_m": one.side_sigma_m,
        "printed_side_m": one.printed_side_m,
        "stereo_side_m": one.stereo_side_m,
        "stereo_side_sigma_m": one.stereo_side_sigma_m,
        "T_on_marker": one.T_on_marker.tolist(),
        "covariance": one.covariance.tolist(),
        "n_views": one.n_views,
        "residual_rms_px": one.residual_rms_px,
    }


def _finite_or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
