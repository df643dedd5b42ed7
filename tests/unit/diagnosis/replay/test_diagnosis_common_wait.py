"""All joints got the same datagrams: what no row shows of when they came, the actuators of most of them do."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.diagnosis.links.recorded import Link, over
from diagnosis.answer import answer
from diagnosis.chain.common_wait import on_their_line
from diagnosis.diagnose import diagnose
from diagnosis.reading.read import Read, examine
from diagnosis.replay.replayer import replayer_of
from diagnosis.replay.stretches import Stretch
from machine.effects.entries import make_entry
from machine.effects.layout import neutral_sets
from machine.effects.registry import effect_named

DRIFTING = Link(jitter_s=3e-4, drift=8e-5, sent_ms=10)  # sent and logged at one rate: no row shows 5 ms of it


def moved(whole: Read) -> tuple[Stretch, ...]:
    assert whole.nominal is not None
    replayer = replayer_of(whole.nominal, whole.stretches)
    assert replayer is not None
    none = neutral_sets(6)
    return on_their_line(whole.stretches, replayer, none, none)


def off_s(stretches: tuple[Stretch, ...]) -> np.ndarray:
    """By how much what was sent lies beside when it was, in the middle of each stretch."""
    found = []
    for one in stretches:
        assert one.sent is not None
        t_s = one.sent.t_s[len(one.sent.t_s) // 2]
        found.append(t_s - round(t_s / 0.01) * 0.01)
    return np.array(found)


@pytest.mark.parametrize("lag_s", [0.0, 0.05])
def test_a_drift_that_no_row_shows_is_seen_by_most_joints(lag_s: float) -> None:
    lag = effect_named("valve_lag")
    assert lag is not None
    whole = examine(over(DRIFTING, (make_entry(lag, 4, {"time_constant_s": lag_s}),) * (lag_s > 0.0)), Path("x"))
    assert np.abs(off_s(whole.stretches)).max() > 4e-3
    assert np.abs(off_s(moved(whole))).max() < 1.5e-3


def test_what_came_on_the_dot_stays() -> None:
    whole = examine(over(Link()), Path("x"))
    assert moved(whole) is whole.stretches


@pytest.mark.parametrize(
    "link",
    [
        DRIFTING,
        Link(jitter_s=3e-4, delay_s=0.004, sent_ms=10),
        pytest.param(Link(jitter_s=3e-4, drift=-7e-5, sent_ms=20), marks=pytest.mark.slow),
    ],
)
def test_a_healthy_machine_behind_drifting_clocks_has_no_fault(link: Link) -> None:
    """Six flow gains and a lag, or a delay, had come of it."""
    found = answer(diagnose(examine(over(link), Path("x"))))
    assert found["verdict"] == "none", found["why"]
