"""What a machine file's effects do before the valve of a plant that has no oil of its own."""

import numpy as np
import pytest

from machine.effects.entries import EffectEntry
from sim_plc.plant.hydraulics import spool_opening
from tests.unit.sim_plc.command_side import side_numbers


def dead_band(half_width: float, full_flow: str) -> EffectEntry:
    return EffectEntry("valve_deadband", 1, (("half_width_frac", half_width),), full_flow)


@pytest.mark.parametrize(("kept", "lost"), [(0.0, 0.05), (0.03, 0.0), (0.03, 0.05)])
def test_a_dead_band_takes_its_width_off_a_full_command_only_where_it_says_so(kept: float, lost: float) -> None:
    side = side_numbers((dead_band(kept, "kept"), dead_band(lost, "lost")), 2, 1e-3)
    for x in np.linspace(-1.0, 1.0, 41):
        expected = np.copysign(max(abs(x) - kept - lost, 0.0) / (1.0 - kept), x)
        assert spool_opening(x, side.dead[0]) * side.full_flow[0] == pytest.approx(expected, abs=1e-12)
    assert (side.dead[1], side.full_flow[1]) == (0.0, 1.0)
