"""What shows only beside a pump that gives less than is asked for: as the only name it gains nothing."""

from pathlib import Path

import pytest
from diagnosis_cases import entry, folder, recording

from diagnosis.cells.dynamic import coupled_cell, stage_cells
from diagnosis.chain.coupling import with_coupling, with_more
from diagnosis.reading.read import read
from diagnosis.replay.replayer import replayer_of
from diagnosis.search.cell import Cell
from diagnosis.search.search import Search, search
from machine.effects.entries import EffectEntry, pack_under

DROOP = entry("supply_droop", None, flow_limit_frac=0.5)
BAND = entry("valve_deadband", 3, half_width_frac=0.06)


def searched(place: Path, *effects: EffectEntry) -> tuple[list[Search], Cell]:
    """Each joint's actuator searched as if it had a pump of its own, and all of them as one cell."""
    whole = read(folder(place, recording(effects=effects)))
    assert whole.nominal is not None
    base, replayer = pack_under((), whole.nominal.n), replayer_of(whole.nominal, whole.stretches)
    assert replayer is not None
    coupled = coupled_cell(replayer, whole.stretches, base, base)
    assert coupled is not None
    return [search(one, False) for one in stage_cells("actuator", replayer, whole.stretches, base, base)], coupled


def test_a_dead_band_that_gains_nothing_alone_is_named_beside_a_droop(tmp_path: Path) -> None:
    alone, coupled = searched(tmp_path, DROOP, BAND)
    droop = search(coupled, False)
    assert [effect.key for effect in droop.chosen.fit.hypothesis] == [("supply_droop", None)]
    found = with_more(droop, alone).chosen.fit
    named = {effect.key: numbers for effect, numbers in found.by_effect}
    assert set(named) == {("supply_droop", None), ("valve_deadband", 3)}
    assert named["valve_deadband", 3] == pytest.approx([0.06], rel=0.02)
    assert named["supply_droop", None] == pytest.approx([0.5], rel=0.02)


def test_a_droop_alone_has_nothing_beside_it(tmp_path: Path) -> None:
    (found,) = with_coupling(*searched(tmp_path, DROOP))
    assert [effect.key for effect in found.chosen.fit.hypothesis] == [("supply_droop", None)]
    assert found.chosen.fit.theta == pytest.approx([0.5], rel=0.02)


def test_without_a_droop_each_joint_stays_by_itself(tmp_path: Path) -> None:
    found = with_coupling(*searched(tmp_path, BAND))
    assert len(found) == 6
    assert [effect.key for one in found for effect in one.chosen.fit.hypothesis] == [("valve_deadband", 3)]
