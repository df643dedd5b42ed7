"""A stage that leaves nearly nothing on the undisturbed machine: what is below the floor tells there, too."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import folder, recording

from diagnosis.baseline.left_over import cells_of, with_baseline
from diagnosis.noise.floor import Whitener
from diagnosis.reading.read import read
from diagnosis.refusal.remainder import QUIET_TIMES
from diagnosis.refusal.remainder import tests_of as fired_tests
from diagnosis.replay.stage_floor import SILENT_SHARE
from diagnosis.replay.stage_replay import Replay
from diagnosis.search.cell import Cell, Rows
from machine.effects.layout import neutral_sets
from machine.remainder import USUAL_ENERGY, Remainder

ROWS = 2000
SMALL = 0.2 * np.random.default_rng(1).normal(size=ROWS)  # a twenty-fifth of the floor's energy


def cell_of(*usual: tuple[str, float], quiet: float = 0.0) -> Cell:
    zeros = np.zeros(ROWS, dtype=np.int64)
    rows = Rows(zeros, np.arange(ROWS) // 100, zeros, zeros)
    return Cell(
        "link", None, "rad", (), neutral_sets(1), lambda sets: np.zeros((sets.sets, ROWS)), rows,
        np.ones(ROWS), quiet, True, False, (), np.arange(ROWS) * 0.05, usual=usual,
    )  # fmt: skip


def names(cell: Cell, residual: np.ndarray = SMALL) -> set[str]:
    return {one.test for one in fired_tests(cell, residual, 1)}


def test_more_than_a_quiet_stage_has_ever_left_is_a_gap() -> None:
    assert names(cell_of((USUAL_ENERGY, 1e-3))) == {"unrest"}
    (one,) = fired_tests(cell_of((USUAL_ENERGY, 1e-3)), SMALL, 1)
    assert one.lead == "is more than the undisturbed machine ever left there"
    assert one.share == pytest.approx(1.0 - QUIET_TIMES * 1e-3 / one.size)


@pytest.mark.parametrize(
    "cell",
    [
        cell_of(),  # nobody knows what it leaves
        cell_of((USUAL_ENERGY, 0.03)),  # as much as once before
        cell_of((USUAL_ENERGY, 0.4)),  # no quiet stage: patterns tell there
        cell_of((USUAL_ENERGY, 1e-3), quiet=0.05),  # this recording's repeats show that noise
        replace(cell_of((USUAL_ENERGY, 1e-3)), floor_known=False),
    ],
)
def test_what_is_usual_or_noise_or_not_known_is_none(cell: Cell) -> None:
    assert names(cell) == set()


@pytest.mark.parametrize(("lost", "told"), [(True, {"unrest"}), (False, set())])
def test_what_differs_between_repeats_of_a_link_that_lost_datagrams_is_no_noise(
    tmp_path: Path, lost: bool, told: set[str]
) -> None:
    """Six lost in as many repeats made the noise that hid them; late ones are noise, and no fault."""
    whole = read(folder(tmp_path, recording(("repeat", "repeat", "steps"), (), 3)))
    link = next(cell for cell in cells_of(whole) if cell.stage == "link")
    assert isinstance(link.whitened, Replay)
    (first, *others) = link.whitened.parts
    sent = first.stretch.sent
    assert sent is not None
    gone = np.zeros(len(sent.t_s), dtype=bool)
    gone[7] = lost
    first = replace(first, stretch=replace(first.stretch, sent=replace(sent, lost=gone)))
    whitened = replace(link.whitened, parts=(first, *others))
    cell = replace(cell_of((USUAL_ENERGY, 1e-3), quiet=0.05), whitened=whitened)
    assert names(cell) == told


def test_what_happens_once_or_twice_is_no_unrest() -> None:
    late = np.zeros(ROWS)
    late[300:305] = late[900:905] = 5.0  # one of thirty-six undisturbed days has such a packet, one in a thousand two
    assert "unrest" not in names(cell_of((USUAL_ENERGY, 1e-3)), late)
    late[1500:1505] = 5.0
    assert "unrest" in names(cell_of((USUAL_ENERGY, 1e-3)), late)


def test_a_trace_is_none() -> None:
    assert names(cell_of((USUAL_ENERGY, 1e-12)), 1e-2 * SMALL) == set()


def test_a_link_without_noise_is_as_quiet_as_its_repeats(tmp_path: Path) -> None:
    whole = read(folder(tmp_path, recording(("repeat", "repeat", "steps"), (), 3)))
    known = tuple(Remainder("link", joint, "", 0.0, 0.0) for joint in (1, 2, 3))
    link = next(cell for cell in cells_of(with_baseline(whole, (), known)) if cell.stage == "link")
    assert link.floor_known
    assert link.quiet < 0.01


@pytest.mark.parametrize(("usual", "share"), [(((USUAL_ENERGY, 1e-9),), SILENT_SHARE), (((USUAL_ENERGY, 0.1),), 1.0)])
def test_a_controller_that_never_left_anything_is_held_to_a_quarter(
    tmp_path: Path, usual: tuple[tuple[str, float], ...], share: float
) -> None:
    whole = read(folder(tmp_path, recording(("repeat", "repeat", "steps"), (), 3)))
    known = tuple(Remainder("controller", joint, "", 0.0, 0.0, usual=usual) for joint in (1, 2, 3))
    cells = cells_of(with_baseline(whole, (), known))
    (replay,) = (cell.whitened for cell in cells if cell.label == "controller 2")
    assert isinstance(replay, Replay)
    plain = next(cell.whitened for cell in cells_of(with_baseline(whole, (), ())) if cell.label == "controller 2")
    assert isinstance(plain, Replay)
    assert replay.whitener.sigma == pytest.approx(share * plain.whitener.sigma)


def test_lags_that_nothing_uses_cost_no_part_of_a_stretch() -> None:
    a = np.array([[0.4, 0.0], [0.0, 0.0], [0.2, 0.0]])
    whitener = Whitener(a, np.array([1.0, 2.0]))
    assert whitener.only([0]).order == 3
    assert whitener.only([1]).order == 0
    assert whitener.only([1]).sigma == pytest.approx([2.0])
