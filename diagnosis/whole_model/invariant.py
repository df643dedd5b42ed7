"""Given a baseline: of sets of effects that fit alike, the one whose sizes are the same everywhere.

A cause has one size in every motion and posture; what only stands in for it has not. So an effect that is doubtful for
its scatter gives way to an equal set that is more likely there than not.
"""

from diagnosis.whole_model.evidence import evidence_of
from diagnosis.whole_model.probability import LIKELY_PROBABILITY, probability
from diagnosis.whole_model.solve import WholeFit, refit_with_exchanged_term


def most_invariant(fit: WholeFit) -> WholeFit:
    """The fit with doubtful effects exchanged for equals that are not; as it is without a baseline.

    Source: invariance as a sign of a cause: Peters, Buehlmann, Meinshausen 2016.
    """
    for _ in range(int(fit.best_fit.present_terms.sum()) if fit.cell.baseline_gain_nats is not None else 0):
        doubtful = [found for found in evidence_of(fit) if probability(found) < LIKELY_PROBABILITY]
        tried = [
            refit_with_exchanged_term(fit, found.effect_term, equal)
            for found in doubtful
            for equal in found.equivalent_effect_sets
        ]
        likely = [other for other in tried if _least_new_probability(other, fit) >= LIKELY_PROBABILITY]
        if not likely:
            break
        fit = max(likely, key=lambda other: other.best_fit.log_posterior_nats)
    return fit


def _least_new_probability(other: WholeFit, fit: WholeFit) -> float:
    """The least probability of the effects that are new in another fit."""
    known = {term.effect.without_variant for term in fit.best_fit.current_terms if term.is_present}
    new = [probability(found) for found in evidence_of(other) if found.effect_term.effect.without_variant not in known]
    return min(new, default=0.0)
