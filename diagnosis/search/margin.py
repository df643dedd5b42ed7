"""What a name has to gain before it is believed."""

from diagnosis.search.candidates import Candidate

MARGIN_NATS = 6.0  # 3 gave false names among dozens of candidates in a dozen cells
MARGIN_MORE_NATS = 2.0  # for each further number that a model has


def margin_of(effect: Candidate) -> float:
    """Of one name alone [nats]."""
    return MARGIN_NATS + MARGIN_MORE_NATS * (len(effect.slots) + len(effect.fixed) - 1)
