"""The issue's lines 5.1 to 5.5 from judged cases: shares with Wilson intervals, reliability, limits, shrink."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median
from typing import Any

from benchmarks.reproduce.summary import Share, share

Cases = Sequence[dict[str, Any]]
LARGE = 2.0  # times the detection limit: from there on names are expected


@dataclass(frozen=True, slots=True)
class Line:
    """One claim: what, what is wanted, the share reached; None where no case belongs to it."""

    claim: str
    wanted: str
    share: Share | None


def _line(claim: str, wanted: str, marks: list[bool]) -> Line:
    return Line(claim, wanted, share(marks) if marks else None)


def large(cases: Cases) -> list[dict[str, Any]]:
    """Cases without an effect, outside the catalogue, or with every effect at twice its limit or more.

    The limit is the one of that very recording, not the table's that sizes were drawn with.
    """
    return [one for one in cases if all(size is None or size >= LARGE for size in one["strengths"])]


def small(cases: Cases) -> list[dict[str, Any]]:
    """Cases of the catalogue with an effect below twice its limit."""
    return [one for one in cases if any(size is not None and size < LARGE for size in one["strengths"])]


def of(cases: Cases, *mixes: str) -> list[dict[str, Any]]:
    """Cases of some kinds."""
    return [one for one in cases if one["mix"] in mixes]


def naming(cases: Cases) -> list[Line]:
    """Line 5.1 (and 5.3 with another plant)."""
    big = large(cases)
    single, double = of(big, "single"), of(big, "double")
    inside = of(big, "none", "single", "double")
    beyond, low = of(big, "foreign", "lacking"), small(of(cases, "single", "double"))
    return [
        _line("none called none", ">= 98 %", [one["none"] for one in of(cases, "none")]),
        _line("single exact", ">= 95 %", [one["exact"] for one in single]),
        _line("single exact, names alone", "", [one["exact_named"] for one in single]),
        _line("double exact", ">= 85 %", [one["exact"] for one in double]),
        _line("double exact, names alone", "", [one["exact_named"] for one in double]),
        _line("double, at least one right", ">= 98 %", [one["some"] for one in double]),
        _line("foreign refused or undecided", ">= 90 %", [one["refused"] for one in of(big, "foreign")]),
        _line("lacking refused or undecided", ">= 90 %", [one["refused"] for one in of(big, "lacking")]),
        _line("lacking, named its equal (T < 9)", "", [bool(one.get("twin")) for one in of(big, "lacking")]),
        _line("false names", "<= 2 %", [bool(one["false"]) for one in inside]),
        _line("false names, outside the catalogue", "0", [bool(one["false"]) for one in beyond]),
        _line("right first stage", ">= 98 %", [bool(one["stage_right"]) for one in (*single, *double)]),
        _line("0.5x to 2x: false names", "<= 5 %", [bool(one["false"]) for one in low]),
        _line("0.5x to 2x: exact", "", [one["exact"] for one in low]),
        _line("90 % set holds the truth", ">= 86 %", [one["credible"] for one in cases]),
    ]  # fmt: skip


def by_factor(cases: Cases) -> list[Line]:
    """Single effects by size over the limit."""
    edges = (0.5, 1.0, 2.0, 4.0, 100.0)
    single = [one for one in of(cases, "single") if one["effects"]]
    return [
        _line(
            f"single exact, {low:g}x to {high:g}x",
            "",
            [one["exact"] for one in single if low <= one["strengths"][0] < high],
        )
        for low, high in pairwise(edges)
    ]


def reliability(cases: Cases) -> list[tuple[str, int, float, float]]:
    """Probabilities of effects in five bins: bin, how many, mean stated, share that is there."""
    stated = [(float(p), bool(right)) for case in cases for p, right in case["probabilities"]]
    out = []
    for low, high in pairwise((0.0, 0.5, 0.9, 0.95, 0.98, 1.0001)):
        own = [(p, right) for p, right in stated if low <= p < high]
        if own:
            mean, share_right = (sum(column) / len(own) for column in zip(*own, strict=True))
            out.append((f"{low:g} to {min(high, 1.0):g}", len(own), mean, share_right))
    return out


def limit_ratios(cases: Cases) -> list[float]:
    """The tool's detection limit over the scorer's, of every true effect with both."""
    return [
        row["tool"] / row["scorer"]
        for one in cases
        for row in one["limits"]
        if row["tool"] is not None and row["scorer"]
    ]


def by_own_limit(cases: Cases) -> list[Line]:
    """Line 5.2: single effects named, by size over the limit that the tool itself gave for that recording; at the limit
    also how many were seen at all, by their own name or not.
    """
    edges = (0.0, 0.7, 0.85, 1.2, 1.6, 100.0)
    told = [
        (strength * row["scorer"] / row["tool"], bool(one["exact_named"]), one["verdict"] != "none")
        for one in of(cases, "single")
        for strength, row in zip(one["strengths"], one["limits"], strict=False)
        if strength is not None and row["tool"]
    ]
    lines = []
    for low, high in pairwise(edges):
        inside = [(named, seen) for times, named, seen in told if low <= times < high]
        at_limit = low < 1.0 < high
        where = f"{low:g}x to {high:g}x the tool's limit"
        lines.append(_line(f"named, {where}", "80 to 97 %" if at_limit else "", [named for named, _ in inside]))
        if at_limit:
            lines.append(_line(f"seen (not `none`), {where}", "", [seen for _, seen in inside]))
    return lines


def shrinks(cases: Cases) -> tuple[float | None, int]:
    """Median closed_frac of exact answers, and how many."""
    closed = [one["closed"].get("closed_frac") for one in cases if one["exact"]]
    known = [value for value in closed if value is not None]
    return (median(known) if known else None), len(known)


def closed_limits(cases: Cases) -> Line:
    """Whether the 90 % limits of closed_frac hold what the named effects really close, of exact answers."""
    told = [(one["closed"], one.get("closed_true")) for one in cases if one["exact"]]
    inside = [
        closed["low"] <= true <= closed["high"]
        for closed, true in told
        if true is not None and closed.get("low") is not None
    ]
    return _line("90 % limits of closed_frac hold it", "84 to 96 %", inside)


def inside_limits(cases: Cases) -> Line:
    """Whether the 90 % limits of rightly named effects hold the true size."""
    return _line("90 % limits hold the size", "84 to 96 %", [row["inside"] for one in cases for row in one["values"]])


def by_stage(cases: Cases) -> list[Line]:
    """Single effects at twice their limit or more, by stage."""
    single = of(large(cases), "single")
    stages = dict.fromkeys(one["effects"][0]["stage"] for one in single if one["effects"])
    return [
        _line(f"single exact, {stage}", "", [o["exact"] for o in single if o["effects"][0]["stage"] == stage])
        for stage in stages
    ]


def failures(cases: Cases) -> list[str]:
    """One line a case that did not come out as wanted, at twice the limit or more."""
    out = []
    for one in large(cases):
        good = (
            one["none"]
            if one["mix"] == "none"
            else one["exact"]
            if one["mix"] in ("single", "double")
            else one["refused"]
        )
        if not good:
            true = ", ".join(
                f"{e['effect']['name']} {e['effect']['joint'] or ''} {size or 0:.2g}x"
                for e, size in zip(one["effects"], one["strengths"], strict=True)
            )
            named = ", ".join(f"{name} {joint or ''}" for name, joint in one["named"])
            out.append(
                f"case {one['number']} {one['mix']} noise {one['noise']}: {true or 'nothing'} -> "
                f"{one['verdict']}: {named or 'nothing'} ({one['why']})"
            )
    return out  # fmt: skip
