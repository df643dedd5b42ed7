"""The closed loop over real UDP and rendered images: it comes back into the tolerance, truly."""

import pytest

from benchmarks.positioning.servo import SETTINGS, run_case, truly_inside

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(420)]


def test_it_comes_back_while_looking(tmp_path):
    settings = tmp_path / "settings.toml"
    settings.write_text(SETTINGS.format(silence_max_ms=170.0))
    case = run_case("realistic", 3, tmp_path / "case", settings, retract_mm=60.0, rate_hz=15.0)
    assert case.state == "done", case.code_or_reason
    assert truly_inside(case), case
    assert case.pairs > 20
