"""Units by the ending of a name: the longest that fits, the same in every message and table."""

import pytest

from machine.field_units import unit_of
from server.api.panel import setting_rows
from server.errors import SettingsError
from server.settings import read_settings


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("speed_max_mm_s", "mm/s"),
        ("tcp_speed_max_m_s", "m/s"),
        ("velocity_gain_rad_s", "rad/s"),
        ("qd_max_deg_s", "deg/s"),
        ("qdd_max_deg_s2", "deg/s^2"),
        ("timeout_s", "s"),
        ("silence_max_ms", "ms"),
        ("age_max_h", "h"),
        ("side_m", "m"),
        ("sigma_print_side_frac", "0..1"),
        ("keys_file", ""),
    ],
)
def test_the_longest_ending_counts(name, unit):
    assert unit_of(name) == unit


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[closed_loop]\nspeed_max_mm_s = -1.0", "[mm/s]"),
        ("[closed_loop]\nsilence_max_ms = 1.0", "[ms]"),
        ("[calibration]\nage_max_h = -1.0", "[h]"),
        ("[look]\ntimeout_s = -1.0", "[s]"),
    ],
)
def test_a_setting_that_is_refused_tells_its_own_unit(tmp_path, text, told):
    (tmp_path / "server.toml").write_text(text)
    with pytest.raises(SettingsError) as refused:
        read_settings(tmp_path / "server.toml")
    assert str(refused.value).endswith(told)


def test_the_panel_shows_the_same_units():
    (row,) = setting_rows({"closed_loop": {"speed_max_mm_s": 80.0}})
    assert (row.name, row.value, row.unit) == ("closed_loop.speed_max_mm_s", "80.0", "mm/s")
