"""The tables of the report as data: ours beside the paper's, what agrees, and what does not and why."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.reproduce.cases import Case
from benchmarks.reproduce.error_budget import bootstrap_mean
from benchmarks.reproduce.paper_tables import (
    STAND_OFF_MM,
    TABLE_2,
    TABLE_2_MEAN,
    TABLE_3,
    TABLE_4,
    TABLE_4_MEAN,
)
from benchmarks.reproduce.summary import mean_errors
from machine.rotations import Array


@dataclass(frozen=True, slots=True)
class TableView:
    """A table to print: title, headings, rows, and a sentence under it."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


@dataclass(frozen=True, slots=True)
class Check:
    """One figure with the bounds that it was expected in."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    n: int

    @property
    def met(self) -> bool:
        """Whether it lies inside; NaN does not."""
        return self.low <= self.value <= self.high


def steps_of(cases: Sequence[Case], name: str, attribute: str) -> Array:
    """Absolute errors (n, 3) of one step over the cases that have it."""
    found = [getattr(step, attribute) for case in cases for step in case.steps if step.name == name]
    return np.abs([one for one in found if one is not None]).reshape(-1, 3)


def table_2_view(fast: dict[str, list[Case]], rendered: dict[str, list[Case]]) -> TableView:
    """Means after the one move, image-based and true, beside the paper's."""
    paper = TABLE_2_MEAN
    rows = [("the paper, printed means", "9", _three(paper.rotation_deg, 2), _three(paper.position_mm, 0), "", "")]
    mine = np.array([row.position_mm for row in TABLE_2], dtype=float).mean(axis=0)
    turns = np.array([row.rotation_deg for row in TABLE_2]).mean(axis=0)
    rows.append(("the paper, means of its nine rows", "9", _three(turns, 2), _three(mine, 1), "", ""))
    for where, by_kind in (("fast", fast), ("rendered, end to end", rendered)):
        for kind, cases in by_kind.items():
            for step, text in (("move", ""), ("servo 1", ", after the servo step")):
                name = f"{where}: {_LINE_NAMES.get(kind, kind)}{text}"
                rows += _mean_row(cases, name, step)
    headings = (
        "",
        "N",
        "rotation X Y Z after orienting [deg]",
        "image X Y Z [mm]",
        "true X Y Z [mm]",
        "true x y [mm], OOI axes",
    )
    return TableView("Table 2: line equation, mean absolute errors in camera axes", headings, tuple(rows), _NOTE_2)


_LINE_NAMES = {
    "paper servo": "as the paper",
    "fit": "improved, fit over all looks",
    "fit, OOI axes": "improved, in the OOI's axes",
}
_NOTE_2 = (
    "The servo row applies eq. 16 once more to what is then measured; the paper found that this does not improve the "
    "end result, because the direction stays. Image-based: what the camera says, as the paper tabulates. True: what "
    "the simulator knows. The paper's zero is in camera axes: with a camera that is tilted by 5 deg, 0.4 m away, zero "
    "there is 35 mm off the OOI's normal; the variant in the OOI's axes aims at that, so its camera-axes errors are "
    "large and its true errors across the normal small."
)


def _mean_row(cases: Sequence[Case], name: str, step: str) -> list[tuple[str, ...]]:
    mean = mean_errors(cases, step)
    if mean.n == 0:
        return []
    turned = steps_of(cases, "oriented", "euler_image_deg")
    if len(turned) == 0:
        turned = steps_of(cases, "oriented", "euler_true_deg")
    across = steps_of(cases, step, "goal_true_mm")[:, :2].mean(axis=0)
    turns = _three(turned.mean(axis=0), 2) if len(turned) and step == "move" else ""
    image, true = _three(mean.camera_image_mm, 1), _three(mean.camera_true_mm, 1)
    return [(name, str(mean.n), turns, image, true, " ".join(f"{value:.1f}" for value in across))]


def table_3_view(cases: Sequence[Case]) -> TableView:
    """Errors between matched odometry and encoders, beside the paper's one example."""
    done = [case for case in cases if case.state == "done"]
    rows = [("the paper, one example", "1", _three(TABLE_3.mean_mm, 1), _three(TABLE_3.maximum_mm, 1))]
    for key, text in (("at once", "ours, points of the same stamp"), ("nearest", "ours, nearest points")):
        if done:
            mean, worst = (_noted(done, f"{key} {kind}") for kind in ("mean", "max"))
            rows.append((f"{text}, mean over machines", str(len(done)), _three(mean, 1), _three(worst, 1)))
    headings = ("", "N", "mean X Y Z [mm], base axes", "maximum X Y Z [mm]")
    return TableView("Table 3: point sets after the match", headings, tuple(rows), _NOTE_3)


_NOTE_3 = (
    "In both, one axis stands out: the one across the plane of the path. With the camera's axes taken for the TCP's, "
    "the match keeps the assumed mount, so a camera that is tilted leaves a wedge between the two planes. In our cell "
    "that axis is x (the wall is ahead); the paper prints Z and does not draw its base axes. The paper's maxima are "
    "larger than ours: it is one example, and peaks of 22 to 58 mm beside means of 2 to 14 mm are moments (a slipped "
    "odometry, or a larger delay while moving), which our odometry does not show."
)


def _noted(cases: Sequence[Case], key: str) -> Array:
    return np.array([[float(case.notes[f"{key} {axis}"]) for axis in "xyz"] for case in cases]).mean(axis=0)


def table_4_view(fast: Sequence[Case], rendered: Sequence[Case]) -> TableView:
    """Means after the first and second control input, and the scatter of depth."""
    rows = []
    for number, step in enumerate(("move 1", "move 2"), start=1):
        printed = TABLE_4_MEAN.first_mm if number == 1 else TABLE_4_MEAN.second_mm
        each = np.array([row.first_mm if number == 1 else row.second_mm for row in TABLE_4])
        sd = float(each[:, 2].std(ddof=1))
        rows.append((f"the paper, input {number}", "10", _three(printed, 1), f"{sd:.1f}", _off(each), "", ""))
        for where, cases in (("fast", fast), ("rendered, end to end", rendered)):
            mean = mean_errors(cases, step)
            if mean.n:
                image = steps_of(cases, step, "camera_image_mm")
                rows.append(
                    (f"{where}, input {number}", str(mean.n), _three(mean.camera_image_mm, 1),
                     f"{mean.depth_sd_mm:.1f}", _off(image), _three(mean.camera_true_mm, 1),
                     _three(mean.goal_true_mm, 1))
                )  # fmt: skip
    headings = (
        "",
        "N",
        "image X Y Z [mm]",
        "sd of Z",
        "mean |Z - 100|",
        "true X Y Z [mm]",
        "true x y z to the goal [mm], OOI axes",
    )
    return TableView(
        "Table 4: trajectory matching, mean absolute errors in camera axes", headings, tuple(rows), _NOTE_4
    )


_NOTE_4 = (
    "Z contains the stand-off of 100 mm. The pattern is the paper's: after the first input X is near, Y is 20 to 30 "
    "mm off in every run (the tilt of the mount times the way), after the second both are millimetres. The true "
    "errors to the goal are larger than what the camera says: the camera judges itself, and zero in tilted camera "
    "axes is not zero across the OOI's normal."
)


def _off(values_mm: Array) -> str:
    return f"{np.abs(values_mm[:, 2] - STAND_OFF_MM).mean():.1f}"


def refusals_view(by_kind: dict[str, list[Case]]) -> TableView:
    """Runs without a figure, by their reason."""
    rows = []
    for kind, cases in by_kind.items():
        reasons: dict[str, int] = {}
        for case in cases:
            if case.state != "done":
                text = f"{case.state}: {case.reason.split(';')[0][:110]}"
                text = "".join("#" if letter.isdigit() else letter for letter in text)
                reasons[text] = reasons.get(text, 0) + 1
        told = "; ".join(f"{count} x {text}" for text, count in sorted(reasons.items(), key=lambda item: -item[1])[:4])
        done = sum(case.state == "done" for case in cases)
        rows.append((kind, str(len(cases)), str(done), told or "none"))
    return TableView("Runs that gave no figure", ("run", "machines", "with a figure", "why not"), tuple(rows), _NOTE_R)


_NOTE_R = "They are left out of the means, as the paper leaves out its ninth measurement of Table 2."


def checks(table_2: dict[str, list[Case]], table_4: Sequence[Case]) -> list[Check]:
    """The figures that the issue asks for, with its bounds."""
    found = []
    for kind, low, high in (("paper servo", 15.0, 40.0), ("fit", 0.0, 8.0)):
        mean = mean_errors(table_2.get(kind, []), "move")
        for axis, value in zip("XY", mean.camera_image_mm, strict=False):
            found.append(Check(f"Table 2, {_LINE_NAMES[kind]}: mean |e_{axis}|", value, low, high, "mm", mean.n))
    first, second = mean_errors(table_4, "move 1"), mean_errors(table_4, "move 2")
    found.append(Check("Table 4, input 1: mean |e_Y|", first.camera_image_mm[1], 15.0, 35.0, "mm", first.n))
    for axis, value in zip("XY", second.camera_image_mm, strict=False):
        found.append(Check(f"Table 4, input 2: mean |e_{axis}|", value, 0.0, 5.0, "mm", second.n))
    for number, mean in ((1, first), (2, second)):
        found.append(Check(f"Table 4, input {number}: sd of depth", mean.depth_sd_mm, 5.0, 15.0, "mm", mean.n))
    return found


def interval(cases: Sequence[Case], step: str, axis: int) -> tuple[float, float]:
    """95 % interval of a mean |e|, camera axes, image-based, by resampling machines."""
    values = steps_of(cases, step, "camera_image_mm")
    if len(values) < 2:
        return float("nan"), float("nan")
    _, low, high = bootstrap_mean(values[:, axis])
    return low, high


def _three(values: Sequence[float] | Array, digits: int) -> str:
    return " / ".join(f"{float(value):.{digits}f}" for value in values)
