"""Where a scan looks beyond its grid: a wave's own phase, and the size at which a limit begins to be felt."""

import numpy as np
import pytest

from diagnosis.search.candidates import named, on_an_arm
from diagnosis.search.scan import foreseen

ANGLE = np.linspace(-1.0, 1.3, 400)


@pytest.mark.parametrize(("amplitude", "phase"), [(0.0027, 0.63), (0.004, -2.9), (0.001, 1.9)])
def test_a_wave_is_sought_at_its_own_amplitude_and_phase(amplitude: float, phase: float) -> None:
    one = next(one for one in named(("encoder_eccentricity",), (1,)) if one.fixed[0][1] == 2.0)
    thetas = one.starts()
    waves = thetas[:, :1] * np.sin(2.0 * ANGLE + thetas[:, 1:])
    gap = amplitude * np.sin(2.0 * ANGLE + phase)
    found = foreseen(one, thetas, -waves / 1e-4, gap / 1e-4)
    assert found[0] == pytest.approx([amplitude, phase], rel=0.05)


def test_a_limit_is_sought_where_it_begins_to_be_felt() -> None:
    (one,) = named(("reference_rate_limit",), (1,))
    thetas, speed = one.starts(), np.abs(np.sin(3.0 * ANGLE)) * 0.3
    cut = np.minimum(speed, thetas) - speed
    found = foreseen(one, thetas, cut, np.minimum(speed, 0.285) - speed)
    felt, beyond = thetas[thetas < 0.3].max(), thetas[thetas > 0.3].min()
    assert found.min() > felt
    assert found.max() < beyond
    assert np.abs(found - 0.285).min() < 0.03 * 0.285


def test_a_limit_that_nothing_reaches_is_sought_no_further() -> None:
    (one,) = named(("reference_rate_limit",), (1,))
    thetas = one.starts()
    assert len(foreseen(one, thetas, np.zeros((len(thetas), 50)), np.ones(50))) == 0


def test_a_jump_of_a_late_packet_does_not_hide_where_a_limit_is_felt() -> None:
    (one,) = named(("reference_rate_limit",), (1,))
    thetas, speed = one.starts(), np.abs(np.sin(3.0 * ANGLE)) * 0.2
    speed[200] = 0.3  # twice the speed for once
    cut = np.minimum(speed, thetas) - speed
    in_floors = cut / 1e-2
    found = foreseen(one, thetas, in_floors, (np.minimum(speed, 0.19) - speed) / 1e-2)
    assert np.abs(found - 0.19).min() < 0.05 * 0.19


def test_what_bends_by_gravity_is_believed_to_bend_as_far_on_a_light_arm() -> None:
    (sag,) = named(("gravity_sag",), (2,))
    crane, light = on_an_arm(sag, 4e4), on_an_arm(sag, 300.0)
    assert crane == sag
    assert [slot.highest for slot in light.slots] == pytest.approx([100.0 * slot.highest for slot in sag.slots])
    assert light.starts() == pytest.approx(100.0 * sag.starts())
    (bias,) = named(("encoder_bias",), (2,))
    assert on_an_arm(bias, 300.0) == bias
    assert on_an_arm(sag, 0.0) == sag  # nobody gave its masses
