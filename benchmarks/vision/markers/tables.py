"""The result as tables, and each acceptance line as a sentence with its figures."""

from collections.abc import Sequence

import numpy as np
from rich.table import Table

from benchmarks.vision.markers.judged import CellResult
from benchmarks.vision.markers.rendered import RenderedCell
from server.vision.object_pose import PoseSettings

KNOWN, SHIPPED = "noise known", f"shipped setting, {PoseSettings().sigma_px:g} px"
TILT_BOUND_MAX_DEG = 1.0  # rms of the angle of the normal
_PARTS = ("tilt", "lateral", "depth")
_HELD = (("inside_position", "n"), ("inside_tilt", "n_tilt"))


def _held(found: dict[str, int]) -> str:
    """Flagged, and the shares of position and tilt that their own 95 % hold."""
    shares = (100.0 * found[part] / found[n] if found[n] else np.nan for part, n in _HELD)
    return f"{found['flagged']:3d} " + " ".join(f"{share:5.1f}" for share in shares)


def _three(values: dict[str, float]) -> str:
    return " ".join(f"{values[part]:6.2f}" for part in _PARTS)


def exact_table(cells: Sequence[CellResult]) -> Table:
    """Every cell of part (i)."""
    table = Table(title="exact projections: rms over the two-view bound (tilt, lateral, depth)", title_justify="left")
    for heading in (
        "side mm", "z m", "tilt", "px", "n", "bound deg", "ours (tilt not flagged)", "IPPE left", "IPPE+LM left",
        "flagged optimal", "flips", "OpenCV", *(f"flagged, position, tilt in 95 %: {how}" for how in (KNOWN, SHIPPED)),
    ):  # fmt: skip
        table.add_column(heading)
    for one in cells:
        table.add_row(
            f"{one.side_m * 1e3:.0f}", f"{one.distance_m:.1f}", f"{one.tilt_deg:.0f}", f"{one.sigma_px:g}", f"{one.n}",
            f"{one.tilt_bound_deg:.2f}", _three(one.ratios["ours"]), _three(one.ratios["IPPE"]),
            _three(one.ratios["IPPE+LM"]), f"{one.flagged_optimal}", f"{one.known['flips']}",
            f"{one.flips_opencv}", _held(one.known), _held(one.shipped),
        )  # fmt: skip
    return table


def exact_lines(cells: Sequence[CellResult]) -> list[str]:
    """3.2 (i), 3.3 and 3.4."""
    n = sum(one.n for one in cells)
    lines = [f"looks: {n} in {len(cells)} cells"]
    bounded = [one for one in cells if one.tilt_bound_deg <= TILT_BOUND_MAX_DEG]
    for method in ("ours", "ours, flagged too", "IPPE", "IPPE+LM"):
        values = [
            one.ratios[method][part] for one in bounded for part in _PARTS if np.isfinite(one.ratios[method][part])
        ]
        if values:
            lines.append(
                f"3.2 (i) {method}: ratio to the bound median {np.median(values):.3f}, worst {max(values):.2f} "
                f"({len(bounded)} cells whose bound on tilt is <= {TILT_BOUND_MAX_DEG:g} deg)"
            )
    for how, found in ((KNOWN, [one.known for one in cells]), (SHIPPED, [one.shipped for one in cells])):
        flips, mirror = _sum(found, "flips"), _sum(found, "nearer_to_mirror")
        lines.append(
            f"3.3 flips taken as true (outside the pose's own 99.9 %), {how}: {flips} of {n}; sure and nearer to the "
            f"mirrored truth at all: {mirror}; OpenCV's first solution, left eye: "
            f"{sum(one.flips_opencv for one in cells)}"
        )
        flagged, optimal = _sum(found, "flagged"), sum(one.flagged_optimal for one in cells)
        share = f"{flagged / optimal:.3f} times" if optimal else "no look of"
        lines.append(f"3.3 flagged, {how}: {flagged}, {share} the optimal fit's {optimal} with a margin below 9")
    clear = [one for one in bounded if one.tilt_deg >= 20.0]
    lines.append(
        f"3.3 flagged where the bound is <= 1 deg and the tilt >= 20 deg, {KNOWN}: "
        f"{_sum([one.known for one in clear], 'flagged')} of {sum(one.n for one in clear)} "
        f"(optimal fit's margin below 9: {sum(one.flagged_optimal for one in clear)})"
    )
    for sigma in sigmas(cells):
        lines += _coverage(f"{sigma:g} px", [one for one in cells if one.sigma_px == sigma])
    return [*lines, *_coverage("pooled", cells)]


def _coverage(name: str, cells: Sequence[CellResult | RenderedCell]) -> list[str]:
    """What the 95 % ellipsoids hold, told the noise and as shipped."""
    lines = []
    for how, found in ((KNOWN, [one.known for one in cells]), (SHIPPED, [one.shipped for one in cells])):
        inside, tilt = (_share(_sum(found, part), _sum(found, n)) for part, n in _HELD)
        lines.append(f"3.4 95 % ellipsoids, {name}, {how}: position {inside}, tilt where not flagged {tilt}")
    return lines


def _sum(found: Sequence[dict[str, int]], name: str) -> int:
    return sum(one[name] for one in found)


def sigmas(cells: Sequence[CellResult]) -> list[float]:
    """The noise levels in the cells."""
    return sorted({one.sigma_px for one in cells})


def _share(count: int, n: int) -> str:
    """Percentage with its own 95 % interval."""
    if n == 0:
        return "none"
    share = count / n
    half = 1.96 * np.sqrt(share * (1.0 - share) / n)
    return f"{100.0 * share:.2f} % (+-{100.0 * half:.2f}, n = {n})"


def rendered_table(cells: Sequence[RenderedCell]) -> Table:
    """Every cell of part (ii)."""
    table = Table(title="rendered: rms over the bound of the measured corners (tilt, lateral, depth)")
    for heading in (
        "side mm", "z m", "tilt", "n", "missed", "corner px", "outward px", "bound deg", f"ours, {KNOWN}", "IPPE+LM",
        f"flagged, position, tilt in 95 %: {SHIPPED}",
    ):  # fmt: skip
        table.add_column(heading)
    for one in cells:
        rival = one.ratios.get("IPPE+LM")
        table.add_row(
            f"{one.side_m * 1e3:.0f}", f"{one.distance_m:.1f}", f"{one.tilt_deg:.0f}", f"{one.n}", f"{one.missed}",
            f"{one.corner_sigma_px:.4f}", f"{one.outward_bias_px:+.4f}", f"{one.tilt_bound_deg:.3f}",
            _three(one.ratios["ours"]), _three(rival) if rival else "", _held(one.shipped) if one.shipped else "",
        )  # fmt: skip
    return table


def rendered_lines(cells: Sequence[RenderedCell]) -> list[str]:
    """3.2 (ii)."""
    found = [one for one in cells if one.biases]
    n = sum(one.n for one in found)
    lines = [
        f"looks: {n} in {len(cells)} cells, {sum(one.missed for one in cells)} without a clean marker in both eyes"
    ]
    for method in ("ours", "ours, shipped", "IPPE", "IPPE+LM"):
        values = [one.ratios[method][part] for one in found for part in _PARTS]
        lines.append(f"3.2 (ii) {method}: ratio to the bound median {np.median(values):.3f}, worst {max(values):.2f}")
    for part in _PARTS:
        sums = np.sum([one.biases[part] for one in found], axis=0) / n
        text = ", ".join(f"{value:+.3f}" for value in sums)
        lines.append(f"3.2 (ii) pooled normalised bias, {part}: {text} (+-{1.0 / np.sqrt(n):.3f})")
    return [*lines, *_coverage("rendered", found)]
