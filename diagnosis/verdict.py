"""What is said of the budget: every stage and joint judged by itself, and the overall verdict by one table."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from diagnosis.localise import Localisation, Place
from diagnosis.reading.read import Read, stages_present
from diagnosis.replay.stretches import stood_still
from diagnosis.shrink import UNKNOWN, BlockSquares, GapClosed
from diagnosis.whole_model.evidence import Evidence
from diagnosis.whole_model.probability import CONFIRMED_PROBABILITY, LIKELY_PROBABILITY, logistic
from diagnosis.whole_model.remainder import lead_of
from diagnosis.whole_model.solve import WholeFit

SMALL_MM, SMALL_SHARE = 0.5, 0.05  # at the tool, of the whole miss: a remainder too small to act on
EXPLAINED_VERDICT_MIN_FRAC = 0.9  # of the squared miss: then the effects explain the gap

Closing = tuple[tuple[tuple[GapClosed, BlockSquares], ...], ...]
Status = Literal["confirmed", "likely", "doubtful"]
Verdict = Literal["none", "effects", "partly", "outside", "undecided"]
StageVerdict = Literal["none", "explained", "partly", "unexplained", "not_measured"]


@dataclass(frozen=True, slots=True)
class EffectLine:
    """One effect of the budget. `tool_rms_mm`: what it does at the tool by itself, with 90 % limits; `squares_mm2`: its
    Shapley value in the column's mean square.
    """

    evidence: Evidence
    budget_column: str
    tool_rms_mm: float
    low_mm: float
    high_mm: float
    squares_mm2: float
    share_frac: float
    probability: float

    @property
    def status(self) -> Status:
        """How sure it is, in a word."""
        if self.probability >= CONFIRMED_PROBABILITY:
            return "confirmed"
        return "likely" if self.probability >= LIKELY_PROBABILITY else "doubtful"


@dataclass(frozen=True, slots=True)
class BudgetColumn:
    """Where the tool stands, how it gets there, or what the camera sees: RMS miss of the nominal model, of the model
    with the confirmed effects, and the noise [mm]. `is_measured`: else the model says it.
    """

    name: str
    before_mm: float
    after_mm: float
    floor_mm: float
    is_measured: bool


@dataclass(frozen=True, slots=True)
class StageLine:
    """One stage, or one joint of it, judged by itself. `before_mm`, `after_mm`: its miss at the tool beyond what noise
    and a healthy machine leave. `verdict_reason`: what would measure it, or what the remainder follows.
    """

    stage: str
    joint: int | None
    verdict: StageVerdict
    before_mm: float | None
    after_mm: float | None
    verdict_reason: str


def together_mm(parts: Iterable[float]) -> float:
    """Independent misses together (root of the sum of squares)."""
    return float(np.sqrt(sum(part**2 for part in parts)))


def has_baseline(whole: Read) -> bool:
    """Whether the machine file knows what the machine usually leaves."""
    return whole.nominal_machine is not None and bool(whole.nominal_machine.baseline_remainders)


def usual_level(whole: Read, stage: str, joint: int | None, measurement: str) -> float:
    """Mean square, in floors, that a healthy machine's part stays below; 1 without a baseline."""
    usual = (
        None if whole.nominal_machine is None else whole.nominal_machine.baseline_remainder(stage, joint, measurement)
    )
    return 1.0 if usual is None else usual.level


PER_JOINT_STAGES = ("link", "controller", "actuator")
MEASUREMENT_ADVICE_BY_STAGE = {
    "link": "log the reference as sent and as received",
    "controller": "log the received reference, the encoders and the valve command",
    "actuator": "log the valve command and the encoders while the joint moves",
    "structure": "measure points on the arm by a tracker, at rest in a dozen postures",
    "camera": "look at a marker from a dozen postures",
}


def stages_of(
    whole: Read,
    lines: tuple[EffectLine, ...],
    columns: tuple[BudgetColumn, ...],
    places: tuple[Localisation, Localisation],
    fits: tuple[WholeFit, ...],
    closing: Closing,
) -> tuple[StageLine, ...]:
    """Every stage, and of those that drive joints every joint, judged by itself."""
    beyond_noise = {
        (row.stage, row.joint)
        for parts in closing
        for row, sums in parts
        # more than the least noise that is believed, and than one more recording of the healthy machine leaves
        if row.closed_frac_with_limits != UNKNOWN
        and sums.before.sum() > sums.row_count * usual_level(whole, row.stage, row.joint, row.measurement)
    }
    before, after = places
    present = stages_present(whole)
    small = small_mm(columns)
    part_of = {id(term): fit.cell.stage for fit in fits for term in fit.best_fit.current_terms}
    stage_of = {id(line): _stage_of_effect(line, present, part_of) for line in lines}
    out = []
    for stage in MEASUREMENT_ADVICE_BY_STAGE:
        if stage not in present:
            out.append(StageLine(stage, None, "not_measured", None, None, MEASUREMENT_ADVICE_BY_STAGE[stage]))
            continue
        joints: Sequence[int | None] = [None]
        if stage in PER_JOINT_STAGES:
            judged = {place.joint for place in before.gap_places if place.stage == stage and place.joint}
            joints = sorted(judged) or [None]
        of_stage = [line for line in lines if stage_of[id(line)] == stage]
        for joint in joints:
            own_joint = (None, joint)
            here = [line for line in of_stage if joint is None or line.evidence.effect_term.effect.joint in own_joint]
            confirmed = any(_is_sure(line) for line in here)
            was, left = _stage_mm(columns, before, stage, joint), _stage_mm(columns, after, stage, joint, after=True)
            matters = any(line.tool_rms_mm > SMALL_MM for line in here if _is_sure(line))
            seen = (
                bool({(stage, joint), (stage, None)} & beyond_noise)
                or matters
                or any(shows_a_gap(line) for line in here)
                or (joint is None and not has_baseline(whole))
            )
            if not seen and was is not None:
                was = left = 0.0
            verdict = stage_verdict(was, left, confirmed, small)
            if verdict == "none" and confirmed and has_baseline(whole):
                verdict = "explained"  # what is sure to have changed is reported, however little it does at the tool
            own = [fit for fit in fits if fit.cell.stage == stage and fit.cell.joint in (None, joint)]
            lead = next(map(lead_of, own), "") if verdict in ("partly", "unexplained") else ""
            out.append(StageLine(stage, joint, verdict, was, left, lead))
    return tuple(out)


def shows_a_gap(line: EffectLine) -> bool:
    """Given a baseline: whether an effect gains what the healthy machine does not, however doubtful a cause it is."""
    return line.evidence.prior_nats is not None and float(logistic(line.evidence.gain_nats)) >= CONFIRMED_PROBABILITY


def _is_sure(line: EffectLine) -> bool:
    return line.status == "confirmed"


def _stage_of_effect(line: EffectLine, present: Collection[str], part_of: dict[int, str]) -> str:
    """The stage that an effect counts in: its own, or the part that showed it where its own was not recorded."""
    term = line.evidence.effect_term
    own = {"joint": "structure", "time": "camera"}.get(term.effect.stage, term.effect.stage)
    return own if own in present else part_of.get(id(term), own)


def _stage_mm(
    columns: tuple[BudgetColumn, ...], places: Localisation, stage: str, joint: int | None, after: bool = False
) -> float | None:
    if stage not in PER_JOINT_STAGES:
        name = "stands" if stage == "structure" else "sees"
        own = next((column for column in columns if column.name == name), None)
        return None if own is None else (own.after_mm if after else own.before_mm)
    there = [place for place in places.gap_places if _is_place_of_stage(place, stage, joint)]
    return float(np.sqrt(sum(place.tcp_mm**2 for place in there))) if there else None


def _is_place_of_stage(place: Place, stage: str, joint: int | None) -> bool:
    return place.stage == stage and place.motion_regime == "all" and joint in (None, place.joint)


def small_mm(columns: tuple[BudgetColumn, ...]) -> float:
    """A miss at the tool that is too small to act on [mm]."""
    return max(SMALL_MM, SMALL_SHARE * together_mm(column.before_mm for column in columns))


def stage_verdict(was: float | None, left: float | None, confirmed: bool, small: float) -> StageVerdict:
    """One stage's word from its miss before and after [mm], and whether one of its effects is confirmed.

    A miss too small to act on does not count, however clear its cause is.
    """
    if was is None or left is None:
        return "not_measured"
    if was <= small:
        return "none"
    if confirmed:
        done = left**2 <= (1.0 - EXPLAINED_VERDICT_MIN_FRAC) * was**2 or left <= small
        return "explained" if done else "partly"
    return "unexplained"


def verdict_of(
    whole: Read,
    lines: tuple[EffectLine, ...],
    columns: tuple[BudgetColumn, ...],
    stages: tuple[StageLine, ...],
    fits: tuple[WholeFit, ...],
    closing: Closing,
) -> tuple[Verdict, str]:
    """The overall verdict: the first row of the table that holds."""
    open_stages = {line.stage for line in stages if line.verdict == "unexplained"}
    shares = [row.closed_frac_with_limits[0] for parts in closing for row, _ in parts if row.stage in open_stages]
    # with every effect, doubtful ones too
    unexplained = any(share is not None and share < EXPLAINED_VERDICT_MIN_FRAC for share in shares)
    confirmed = any(stage.verdict in ("explained", "partly") for stage in stages)
    squares = sum(column.before_mm**2 for column in columns)
    left = sum(column.after_mm**2 for column in columns)
    explained = 1.0 - left / squares if squares > 0.0 else 0.0
    share = f"confirmed effects explain {100 * explained:.0f} % of it" if squares else "effects are confirmed"
    done = explained >= EXPLAINED_VERDICT_MIN_FRAC or float(np.sqrt(left)) <= small_mm(columns)
    known = all(fit.cell.floor_known for fit in fits) and bool(fits)
    likely = any(line.status != "doubtful" for line in lines)
    gap = any(stage.verdict == "unexplained" for stage in stages)
    unplaced = any(line.status == "confirmed" and not line.budget_column for line in lines)
    static = whole.tables is not None and whole.tables.static is not None
    table: tuple[tuple[bool, Verdict, str], ...] = (
        (not fits, "undecided", "no stage could be replayed"),
        (stood_still(whole.stretches) and not static, "undecided", "no joint moved, and there are no poses at rest"),
        (confirmed and done, "effects", share),
        (confirmed, "partly", f"{share}; the rest has no cause yet"),
        (unplaced, "effects", "effects are confirmed; nothing here says what they do at the tool"),
        (gap and likely and not (known and unexplained), "undecided", "effects are likely, none is confirmed"),
        (gap and known, "outside", "there is a gap, and no effect of the catalogue explains it"),
        (gap, "undecided", "more is left than the noise was taken for, and the noise was never measured"),
        (known, "none", "nothing stands out of the noise that matters at the tool"),
        (True, "undecided", "nothing stands out, but the noise was never measured: repeat one command four times"),
    )
    return next((word, why) for holds, word, why in table if holds)
