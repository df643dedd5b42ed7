"""What widens an answer, by its source: one rule for every unknown that has a name, a sigma and a Jacobian.

An answer e depends on unknowns x by J = d e / d x; cov(e) = J P J^T. What knowing some of them exactly would take away
is their contribution, and the source with the largest one is what a further measurement should reduce.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from server.calibration.contracts import Array
from server.calibration.joint_lens import FOCAL, N_LENS, OOI_PRINT, TOOL_PRINT

MACHINE, MOUNT, MARKER = "machine geometry and sag", "camera mount", "tool marker mount"
SCALE, CLOCK, LENS = "odometry scale", "camera clock", "lens and rig"
FOCAL_LENGTH, TOOL_SIDE, OOI_SIDE = "camera focal length", "tool marker print", "OOI marker print"
LAYOUT, REST, SCATTER = "OOI marker layout", "joint rest positions", "scatter of the look"
_CALIBRATE = "drive another calibration path with more depth and turn"
_PRINT = "measure the printed sides with a caliper and set [position] sigma_print_side_frac"
REMEDIES: Mapping[str, str] = {
    MACHINE: _CALIBRATE,
    MOUNT: _CALIBRATE,
    SCALE: _CALIBRATE,
    CLOCK: _CALIBRATE,
    FOCAL_LENGTH: "drive a path with 0.3 m in depth, or tape one distance (longreach camera check --tape)",
    LENS: "calibrate the camera",
    MARKER: "measure how the marker sits on the tool, or look from nearer",
    TOOL_SIDE: _PRINT,
    OOI_SIDE: _PRINT,
    LAYOUT: "teach the layout (longreach target teach), or come nearer",
    REST: "let the joints end their moves nearer to their references",
    SCATTER: "look over more pairs, from nearer, with clean lens and markers",
}


@dataclass(frozen=True, slots=True)
class Contribution:
    """What one source adds to the variances (3,) of an answer's x, y, z [m^2]."""

    name: str
    variance: Array


def lens_groups(first: int = 0) -> dict[str, list[int]]:
    """The lens unknowns by source; `first`: index of the first one."""
    others = [first + i for i in range(N_LENS) if i not in (FOCAL, TOOL_PRINT, OOI_PRINT)]
    named = {FOCAL_LENGTH: FOCAL, TOOL_SIDE: TOOL_PRINT, OOI_SIDE: OOI_PRINT}
    return {**{name: [first + i] for name, i in named.items()}, LENS: others}


def contributions_by_group(J: Array, covariance: Array, groups: Mapping[str, Sequence[int]]) -> list[Contribution]:
    """Of each group of unknowns.

    Model:   J P_g (P_gg)^-1 P_g^T J^T, the part of J P J^T that is gone once the unknowns g are known exactly.
    Args:    J (3, n); covariance (n, n); groups: indices of the unknowns by source.
    """
    found = []
    for name, indices in groups.items():
        cross = J @ covariance[:, indices]
        part = cross @ np.linalg.pinv(covariance[np.ix_(indices, indices)]) @ cross.T
        found.append(Contribution(name, np.diag(part)))
    return found


def largest_in_words(found: Sequence[Contribution], axis: int) -> str:
    """The largest source on an axis, its one sigma and its remedy; empty without any."""
    if not found:
        return ""
    top = max(found, key=lambda one: float(one.variance[axis]))
    return f"largest contribution: {top.name} ({1e3 * float(np.sqrt(top.variance[axis])):.1f} mm); {REMEDIES[top.name]}"
