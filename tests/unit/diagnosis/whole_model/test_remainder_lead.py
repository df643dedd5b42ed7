"""The lead of a remainder: the signal that explains most of it, and none where it is noise."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from diagnosis.whole_model.remainder import explained_share, lead_of

N = 2000


def fit_with(residual: np.ndarray, **signals: np.ndarray) -> Any:
    part = SimpleNamespace(regressors=tuple(signals.items()), t_s=np.arange(N) * 0.05)
    cell = SimpleNamespace(loose_target_text="", by_part=lambda values: ((part, values),))
    return cast(
        Any, SimpleNamespace(cell=cell, best_fit=SimpleNamespace(linear_model=SimpleNamespace(residual=residual)))
    )


def test_the_signal_that_a_remainder_follows_is_named_with_its_share() -> None:
    rng = np.random.default_rng(2)
    way, position = np.sign(rng.normal(size=N)), rng.uniform(-1.0, 1.0, N)
    found = lead_of(fit_with(way + 0.5 * rng.normal(size=N), position=position, way=way))
    assert found == "goes with the way (explains 80 % of it)"


def test_noise_has_no_lead_and_a_constant_remainder_none_either() -> None:
    rng = np.random.default_rng(3)
    assert lead_of(fit_with(rng.normal(size=N), position=rng.uniform(size=N))) == ""
    assert explained_share(np.ones(N), rng.normal(size=N)) == 0.0
