"""Wrong simulator settings name the field, its value and the bound."""

import pytest

from sim_plc.process import SimSettings, SimSettingsError


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        ("framing", "udp", "framing = 'udp': must be one of raw, eap"),
        ("enable", "yes", "enable = 'yes': must be one of auto, panel"),
        ("plc_port", 70000, "plc_port = 70000"),
        ("camera_port", -1, "camera_port = -1"),
        ("camera_rate_hz", 0.0, "camera_rate_hz = 0.0: must be 0.1..120 Hz"),
        ("seed", -1, "seed = -1"),
        ("structure_frac", 0.5, "structure_frac = 0.5: must be 0..0.4"),
        ("structure_contrast_frac", -0.1, "structure_contrast_frac = -0.1: must be 0..1"),
        ("plc_net_id", "1.2.3", "plc_net_id"),
    ],
)
def test_a_wrong_setting_is_named(field, value, text):
    with pytest.raises(SimSettingsError, match=text.replace(".", r"\.")):
        SimSettings("", **{field: value})
