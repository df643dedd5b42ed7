"""The simulator's shrink as JSON of the answer, and as lines for a terminal."""

from typing import Any

import numpy as np

from longreach.simulated_shrink.compare import Closed, closed
from longreach.simulated_shrink.run import COMMANDS, JOINTS, POINTS, SEEN, SimulatedRuns

METRICS = {
    JOINTS: ("RMS of the encoders, the loop closed by the simulator's controller", "rad"),
    COMMANDS: ("RMS of the joints' speeds, the plant driven by the measured valve commands", "rad/s"),
    POINTS: ("RMS of measured points of the tool", "m"),
    SEEN: ("RMS of where the camera and the simulator's tool put the object, about its mean", "m"),
}


def summary(runs: SimulatedRuns, replayed_frac: float | None) -> dict[str, Any]:
    """For the answer, under `simulated_shrink`. `replayed_frac`: what the diagnosis' own replay says is closed."""
    return {
        "plant": runs.plant,
        "held_out": runs.held_out,
        "driven_by_sent": runs.sent,
        "seconds": round(runs.seconds, 1),
        "drives": [_drive(name, runs) for name in runs.errors],
        "replayed_closed_frac": replayed_frac,
        "notes": list(runs.notes),
    }


def _drive(name: str, runs: SimulatedRuns) -> dict[str, Any]:
    errors = runs.errors[name]
    metric, unit = METRICS[name]
    out: dict[str, Any] = {"drive": name, "metric": metric, "unit": unit, "overall": _numbers(closed(errors))}
    if name in (JOINTS, COMMANDS):
        columns = range(errors[0].before.shape[1])
        out["joints"] = [{"joint": j + 1, **_numbers(closed(errors, j))} for j in columns]
    return out


def _numbers(one: Closed) -> dict[str, float | None]:
    return {name: _round(getattr(one, name)) for name in ("before", "after", "floor", "closed_frac")}


def _round(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(f"{value:.6g}")


def lines(result: dict[str, Any]) -> list[str]:
    """For a terminal: one line a joint, then both closed shares side by side."""
    out = [f"simulated: {result['plant']}; {result['seconds']:g} s of the recording, before and after the effects"]
    for drive in result["drives"]:
        out.append(f"  {drive['metric']} [{drive['unit']}]: {_text(drive['overall'])}")
        out += [f"    joint {joint['joint']}: {_text(joint)}" for joint in drive.get("joints", [])]
    replayed = result["replayed_closed_frac"]
    if replayed is not None:
        out.append(f"  the diagnosis' own replay says: {100 * replayed:.3g} % closed")
    return [*out, *(f"  {note}" for note in result["notes"])]


def _text(one: dict[str, float | None]) -> str:
    floor = "" if one["floor"] is None else f", floor {one['floor']:.3g}"
    share = "no gap above the floor" if one["closed_frac"] is None else f"{100 * one['closed_frac']:.3g} % closed"
    return f"{one['before']:.3g} -> {one['after']:.3g}{floor}: {share}"
