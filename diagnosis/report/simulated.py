"""The gap as the simulator itself shows it, beside what the diagnosis' own replay says."""

from html import escape
from typing import Any

from diagnosis.report.html import table

HEADINGS = ("driven by", "joint", "before", "after", "noise floor", "unit", "closed")


def simulated_section(result: dict[str, Any]) -> str:
    """The closing section's body; empty where the simulator was not asked."""
    found = result.get("simulated_shrink")
    if not found:
        return ""
    rows = []
    for drive in found["drives"]:
        for one in ({"joint": "all", **drive["overall"]}, *drive.get("joints", ())):
            closed = "no gap above the floor" if one["closed_frac"] is None else f"{100 * one['closed_frac']:.1f} %"
            rows.append(
                (drive["drive"], one["joint"], one["before"], one["after"], one["floor"], drive["unit"], closed)
            )
    replayed = found["replayed_closed_frac"]
    beside = "" if replayed is None else f" The diagnosis' own replay says {100 * replayed:.1f} %."
    kept = "with effects fitted without each stretch's kind" if found["held_out"] else "not all of it held out"
    text = f"Run by the simulator: {found['plant']}; {found['seconds']:g} s, {kept}.{beside}"
    notes = "".join(f"<li>{escape(note)}</li>" for note in found["notes"])
    return f"<p>{escape(text)}</p>{table(HEADINGS, rows)}" + (f"<ul>{notes}</ul>" if notes else "")
