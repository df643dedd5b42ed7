"""A machine file with effects as the simulator runs it: nothing drawn, the file's effects and no others."""

import numpy as np
import pytest

from longreach.sim_command import _keep_simulated_effects
from machine.description import parse_machine_toml
from server.settings import read_machine_text
from sim_plc.diagnosed import with_effects
from sim_plc.draw_world import draw_world

TEXT = read_machine_text("hiab033")
SAG = '\n[[effect]]\nname = "gravity_sag"\njoint = 2\nparameters = { compliance_rad_nm = 1e-6 }\n'
DEAD = '\n[[effect]]\nname = "valve_deadband"\njoint = 3\nparameters = { half_width_frac = 0.02 }\n'
TILT = '\n[[effect]]\nname = "base_tilt"\nparameters = { tilt_rad = 0.003 }\n'


def test_the_files_effects_and_no_others_are_simulated():
    text, left_out = _keep_simulated_effects(TEXT + SAG + DEAD + TILT)
    assert left_out == ("base_tilt",)  # said on the screen
    plant = with_effects(draw_world(parse_machine_toml(text), "nominal", 1)).plant
    assert 1.0 / plant.flex.stiffness_nm_rad[0] == pytest.approx(1e-6, rel=0.05)
    assert (1.0 / plant.flex.stiffness_nm_rad[1:] < 5e-8).all()
    assert np.allclose(plant.valve.dead_band_frac, [0.0, 0.0, 0.02, 0.0, 0.0, 0.0])
    assert not plant.kinematics.backlash_rad.any()
    assert _keep_simulated_effects(TEXT) == (TEXT, None)
