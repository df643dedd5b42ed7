"""The step of a rounded reference, read off its values; lost datagrams, read off their numbers."""

from types import SimpleNamespace

import numpy as np
import pytest
from diagnosis_cases import PLANT

from diagnosis.datagrams.lost import never_received
from diagnosis.datagrams.sent import SentReference
from diagnosis.replay.read_off import candidates_within_log, comb_of, read_off
from diagnosis.replay.stretches import Stretch
from diagnosis.search.candidates import candidates_of
from machine.effects.dynamics import drive_by_sent, simulate
from machine.effects.entries import make_entry, pack_effects
from machine.effects.registry import effect_named

WALK = np.cumsum(np.random.default_rng(1).normal(0.0, 1e-3, 5000))


@pytest.mark.parametrize("step", [7e-6, 3.3e-5, 1e-3, 4e-3])
def test_a_comb_is_found_through_the_logs_own_rounding(step: float) -> None:
    rounded = np.round(np.round(WALK / step) * step, 9)
    assert comb_of(rounded) == pytest.approx(step, rel=1e-6)


def test_no_comb_is_seen_where_there_is_none() -> None:
    assert comb_of(WALK) is None
    assert comb_of(np.round(WALK / 1e-3) * 1e-3 + 4e-4) is None  # even, but no whole multiples
    assert comb_of(np.array([0.0, 0.5, 0.5, np.nan])) is None


def stretch(ref: np.ndarray, lost: np.ndarray | None = None) -> Stretch:
    t_s = 0.005 * np.arange(len(ref))
    sent = SentReference(t_s, ref, lost)
    return Stretch("a", "steps", "", 0.0, 0.005, t_s, ref, None, None, sent)


def sizes(ref: np.ndarray, lost: np.ndarray | None, name: str) -> dict[int | None, list[float]]:
    found = read_off(candidates_of("link", (1, 2), True), (stretch(ref, lost),))
    return {term.joint: term.scan_points().ravel().tolist() for term in found if term.name == name}


def test_only_the_rounded_joints_candidate_is_narrowed() -> None:
    found = sizes(np.stack([WALK, np.round(WALK / 1e-3) * 1e-3], axis=1), None, "reference_quantisation")
    assert len(found[1]) > 1
    assert found[2] == pytest.approx([1e-3])


def test_a_loss_is_counted_where_numbers_tell_it() -> None:
    ref, lost = np.stack([WALK, WALK], axis=1), np.zeros(len(WALK), dtype=bool)
    assert len(sizes(ref, None, "packet_loss")[None]) > 1  # the log cannot tell: any share may be
    assert sizes(ref, lost, "packet_loss") == {}
    lost[100:150] = True
    assert sizes(ref, lost, "packet_loss")[None] == pytest.approx([0.01])


def test_known_losses_are_replayed_one_by_one() -> None:
    rng = np.random.default_rng(3)
    t_s, q = 0.004 * np.arange(500), rng.normal(size=(500, 6))
    lost = rng.uniform(size=500) < 0.1
    lost[0] = False
    effect = effect_named("packet_loss")
    assert effect is not None
    lossy = pack_effects([make_entry(effect, None, {"loss_frac": 0.01})], 6)
    replayed = simulate(PLANT, lossy, drive_by_sent(PLANT, t_s, q, 0.0, 1500, lost=lost)).ref
    arrived = simulate(PLANT, pack_effects((), 6), drive_by_sent(PLANT, t_s[~lost], q[~lost], 0.0, 1500)).ref
    np.testing.assert_array_equal(replayed, arrived)


@pytest.mark.parametrize(("logged_s", "told"), [(0.005, True), (0.02, False)])
def test_a_gap_in_the_numbers_tells_only_where_every_datagram_would_be_logged(logged_s: float, told: bool) -> None:
    t_plc = np.arange(0.0, 0.9, logged_s)
    seq = np.round(t_plc / 0.01 - 0.25).astype(np.int64)
    seq[seq == 40] = 39
    lost, judged = never_received((0.01 * np.arange(100), np.arange(100)), (t_plc, seq))
    if told:
        assert lost is not None
        assert judged is not None
        assert np.nonzero(lost)[0].tolist() == [40]
        assert judged[1:89].all()
    else:
        assert lost is None


def test_a_limit_of_the_command_lies_above_all_that_was_commanded() -> None:
    (limit,) = (one for one in candidates_of("controller", (1,), False) if one.name == "controller_saturation")
    part = SimpleNamespace(u=np.array([[0.1], [-0.6], [0.3]]))
    (narrowed,) = candidates_within_log((limit,), (part,))  # pyright: ignore[reportArgumentType]
    assert narrowed.parameter_slots[0].lower_bound == pytest.approx(0.588)
    assert narrowed.parameter_slots[0].start_value >= narrowed.parameter_slots[0].lower_bound
    full = SimpleNamespace(u=np.array([[1.0]]))
    assert not [
        candidate
        for candidate in candidates_within_log((limit,), (full,))
        if candidate.parameter_slots[0].lower_bound < 0.97
    ]  # pyright: ignore[reportArgumentType]
