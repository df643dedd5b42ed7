"""Step: every encoder says what is read at the machine itself (scale, mark or inclinometer)."""

import math

from server.commissioning.contracts import Figure, ReportTable, StepResult, Verdict, judged, skipped
from server.commissioning.moving import Reading, reading
from server.commissioning.site import Site

NAME = "encoder zeros"
REMEDY = "set the encoder's offset in the PLC so that it agrees with the mark, then run this step again"


async def encoder_zeros(site: Site) -> StepResult:
    """Ask for the angle of every joint as read at the machine; the encoder's value is shown only afterwards."""
    site.operator.tell("put every joint on a known mark, or read its angle at the machine; leave empty what you cannot")
    seen_deg: list[float | None] = []
    for joint in site.machine.joints:
        bounds = f"{math.degrees(joint.q_min_rad):.0f} .. {math.degrees(joint.q_max_rad):.0f}"
        question = f"{joint.name}: angle read at the machine [deg, {bounds}; empty: not read]"
        seen_deg.append(await _angle(site, f"encoder_zeros.{joint.name}", question))
    names = [joint.name for joint in site.machine.joints]
    return compare_zeros(names, await reading(site), seen_deg, site.options.zero_tolerance_deg)


async def _angle(site: Site, key: str, question: str) -> float | None:
    """A number, asked again until it is one; None when nobody says."""
    for _ in range(3):
        answer = await site.operator.ask(key, question)
        if answer is None or not answer.strip():
            return None
        try:
            value = float(answer)
        except ValueError:
            value = math.nan
        if math.isfinite(value):
            return value
        site.operator.tell(f"'{answer}' is not a number; give degrees, such as 12.5")
    return None


def compare_zeros(
    names: list[str], reading_now: Reading, seen_deg: list[float | None], tolerance_deg: float
) -> StepResult:
    """The result for what was read at the machine; None: not read."""
    q_deg = [math.degrees(value) for value in reading_now.q]
    pairs = list(zip(names, q_deg, seen_deg, strict=True))
    figures = [
        Figure(f"{name}: encoder against the mark", abs(q - seen), "deg", at_most=tolerance_deg)
        for name, q, seen in pairs
        if seen is not None
    ]
    untold = [name for name, _, seen in pairs if seen is None]
    rows = tuple((name, f"{q:+.3f}", "" if seen is None else f"{seen:+.3f}") for name, q, seen in pairs)
    table = ReportTable("angles", ("joint", "encoder deg", "read at the machine deg"), rows)
    if not figures:
        skip = skipped(NAME, "no angle was read at the machine", "read them, or give them in --answers")
        return StepResult(NAME, Verdict.SKIPPED, skip.summary, remedy=skip.remedy, tables=(table,))
    missing = [f"not read at the machine: {', '.join(untold)}"] if untold else []
    summary = f"all encoders within {tolerance_deg:g} deg of their marks"
    return judged(NAME, figures, summary, REMEDY, missing, tables=(table,))
