"""The answer in a few lines for a terminal."""

from typing import Any

LISTED_EFFECTS_MAX = 5


def report_lines(result: dict[str, Any]) -> list[str]:
    """What a person reads after the budget."""
    out = [f"verdict: {result['verdict']} ({result['why']})"]
    places = list(dict.fromkeys(place_text(members[0]) for members in result["indistinguishable"]))
    for place in places[:LISTED_EFFECTS_MAX]:
        rows = [members[1:] for members in result["indistinguishable"] if place_text(members[0]) == place]
        others = dict.fromkeys(" + ".join(map(place_text, row)) for row in rows)
        out.append(f"this recording cannot distinguish {place} from {', or '.join(others)}")
    if len(places) > LISTED_EFFECTS_MAX:
        out.append(
            f"{len(places) - LISTED_EFFECTS_MAX} further effects cannot be distinguished from others: see the report"
        )
    closed = result["shrink"].get("overall", {}).get("closed_frac")
    if closed is not None:
        out.append(f"gap closed on held-out motions: {100 * closed:.3g} %")
    for row in result["unexplained"][:LISTED_EFFECTS_MAX]:
        where = f"{row['stage']} {row['joint']}" if row["joint"] else row["stage"]
        out.append(f"unexplained in {where}: {row['lead'] or 'more than noise'} ({row['test']} {row['size']:.3g})")
    following = result["next_experiment"]
    if following["what"]:
        out.append(f"next experiment: {following['what']}, {following['minutes']:g} min: {following['why']}")
    out += [f"missing: {missing['costs']}" for missing in result["missing"]]
    return out


def place_text(place: dict[str, Any]) -> str:
    """An effect and its joint."""
    return place["name"] + (f" on joint {place['joint']}" if place["joint"] is not None else "")
