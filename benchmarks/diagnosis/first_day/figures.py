"""Many scored cases in a few rows: coverage, false effects, sizes, shares, shrink, verdicts, probabilities, time."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
from scipy.stats import binomtest

from benchmarks.diagnosis.first_day.score import Reported, Score, TrueEffect
from benchmarks.positioning.machines.command import share_text
from benchmarks.reproduce.summary import Share

Scores = Sequence[Score]
Row = tuple[str, str, str]  # what, wanted, reached
BINS = 5
POINTS = 0.05  # of the squared millimetres of all effects
FOREIGN = ("foreign", "foreign_many")
HEALTHY = ("healthy", "healthy_no_repeats")


def wilson(flags: Sequence[bool]) -> Share:
    """Share of the true ones with its 95 % interval (Wilson 1927)."""
    k, n = sum(flags), len(flags)
    if n == 0:
        return Share(0, 0, 0.0, 1.0)
    interval = binomtest(k, n).proportion_ci(0.95, "wilson")
    return Share(k, n, float(interval.low), float(interval.high))


def rows(scores: Scores) -> list[Row]:
    """The table of a campaign."""
    confirmed = [effect for score in scores for effect in score.reported if effect.confirmed]
    return [
        _middle("true squared tip error covered by confirmed effects", ">= 0.9", _coverage(scores, seen=False)),
        _middle("true squared error of what the camera sees, covered", ">= 0.9", _coverage(scores, seen=True)),
        _share("confirmed effects that are there (or an equal is)", ">= 98 %", [effect.there for effect in confirmed]),
        _share("true effects > 2 mm that are confirmed", "", [effect.found for effect in _large(scores)]),
        _share(
            "shares within 5 points", ">= 90 %", [_share_is_right(effect) for effect in confirmed if effect.true_share]
        ),
        _share(
            "90 % limits of confirmed sizes that hold the truth",
            "90 %",
            [effect.inside for effect in confirmed if effect.inside is not None],
        ),
        _middle("left / miss after adding the confirmed effects, as stated", "<= 0.3", _shrinks(scores)),
        _share("healthy: verdict none", ">= 98 %", [effect.verdict == "none" for effect in _of(scores, HEALTHY)]),
        _share(
            "foreign: no effect confirmed that is not there",
            ">= 98 %",
            [not any(_is_false(effect) for effect in score.reported) for score in _of(scores, FOREIGN)],
        ),
        _middle("seconds a case", "", [score.seconds for score in scores]),
    ]


def _of(scores: Scores, kinds: Sequence[str]) -> list[Score]:
    return [score for score in scores if score.kind in kinds]


def _is_false(effect: Reported) -> bool:
    return effect.confirmed and not effect.there


def _share_is_right(effect: Reported) -> bool:
    return effect.true_share is not None and abs(effect.share - effect.true_share) <= POINTS


def _large(scores: Scores) -> list[TrueEffect]:
    return [effect for score in scores for effect in score.true if max(effect.tip_mm, effect.seen_mm) > 2.0]


def _coverage(scores: Scores, seen: bool) -> list[float]:
    return [value for score in scores if (value := score.coverage(seen)) is not None]


def _shrinks(scores: Scores) -> list[float]:
    return [
        score.left_mm / score.miss_mm
        for score in scores
        if score.left_mm is not None and score.miss_mm and score.verdict in ("effects", "partly")
    ]


def _middle(what: str, wanted: str, values: Sequence[float]) -> Row:
    if not values:
        return what, wanted, "no case"
    low, middle, high = np.quantile(values, (0.1, 0.5, 0.9))
    return what, wanted, f"median {middle:.3g}, 10 to 90 %: {low:.3g} to {high:.3g}, N = {len(values)}"


def _share(what: str, wanted: str, flags: Sequence[bool]) -> Row:
    return what, wanted, share_text(wilson(flags)) if flags else "no case"


def verdicts(scores: Scores) -> list[tuple[str, int, dict[str, int]]]:
    """By kind: its cases, and how often each verdict was given."""
    kinds = sorted({score.kind for score in scores})
    counts = {kind: Counter(score.verdict for score in scores if score.kind == kind) for kind in kinds}
    return [(kind, sum(counted.values()), dict(counted)) for kind, counted in counts.items()]


def reliability(stated: Sequence[float], right: Sequence[bool]) -> list[tuple[str, float, Share]]:
    """In five bins of equal width: the bin, the mean stated, the share right."""
    p, flags = np.asarray(stated, dtype=float), np.asarray(right, dtype=bool)
    at = np.minimum((p * BINS).astype(int), BINS - 1)
    return [
        (f"{k / BINS:g} to {(k + 1) / BINS:g}", float(p[at == k].mean()), wilson(flags[at == k].tolist()))
        for k in range(BINS)
        if (at == k).any()
    ]


def failures(scores: Scores) -> list[str]:
    """Case by case, the false confirmed effects, and the large true ones that were not found."""
    out = []
    for score in scores:
        false = [f"{effect.name} {effect.joint} {effect.mm:.2f} mm" for effect in score.reported if _is_false(effect)]
        missed = [
            f"{effect.name} {effect.joint} {max(effect.tip_mm, effect.seen_mm):.1f} mm"
            for effect in _large([score])
            if not effect.found
        ]
        if false or missed:
            out.append(
                f"{score.kind} seed {score.seed} case {score.number} ({score.verdict}): "
                f"false {', '.join(false) or '-'}; missed {', '.join(missed) or '-'}"
            )
    return out
