"""Why a transport delay is not compensated: it changes when a move ends, not where."""

import numpy as np

from machine.description import parse_machine_toml
from machine.effects.dynamics import actuators_of, drive_by_sent, simulate
from machine.effects.entries import EffectEntry, pack_effects
from server.settings import read_machine_text

PLANT = actuators_of(parse_machine_toml(read_machine_text("hiab033")))
Q_START = np.array([0.3, 0.5, -1.0, 0.2, 0.8, -0.4])
LOST_MOTION = (
    EffectEntry("valve_deadband", 2, (("half_width_frac", 0.03),)),
    EffectEntry("valve_hysteresis", 3, (("half_width_frac", 0.02),)),
    EffectEntry("stiction", 1, (("breakaway_frac", 0.02),)),
)


def moved(effects):
    """Encoders (rows, 6) of a move there and part of the way back, then rest."""
    t = 0.005 * np.arange(6000)
    there, back = (np.clip((t - at) / 3.0, 0.0, 1.0) for at in (1.0, 6.0))
    way = np.array([0.2, -0.15, 0.1, 0.05, -0.1, 0.1])
    ease = [10 * u**3 - 15 * u**4 + 6 * u**5 for u in (there, back)]
    sent = Q_START + (ease[0] - 0.4 * ease[1])[:, None] * way
    return simulate(
        PLANT, pack_effects(effects, 6), drive_by_sent(PLANT, t, sent, 0.0, round(30.0 / PLANT.cycle_s))
    ).enc[0]


def test_a_late_move_ends_where_a_punctual_one_does_whatever_motion_is_lost():
    late = EffectEntry("transport_delay", None, (("delay_s", 0.15),))
    punctual, delayed = moved(LOST_MOTION), moved((*LOST_MOTION, late))
    assert np.abs(delayed - punctual).max() > 5e-3  # on the way
    assert np.abs(delayed[-1] - punctual[-1]).max() < 1e-5  # at rest: 0.04 mm at 4 m, of a play that still settles
    assert np.abs(moved(())[-1] - punctual[-1]).max() > 1e-3  # while lost motion does change the end
