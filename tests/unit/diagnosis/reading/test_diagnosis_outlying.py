"""Points that no model of the arm comes near are named and left out; what a model explains never is."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_cases import MACHINE_TOML, likely
from static_points import POINTS, examined, packed, static_recording

from diagnosis.answer import answer_json
from diagnosis.budget import budget_of
from machine.effects.layout import ParameterSets, neutral_sets
from recording.content import Recording
from recording.rows import StaticPoint

FREE = MACHINE_TOML + "\n[points]\ntip = { joint = 6 }\nelbow = { joint = 2 }\n"
LONG = packed("link_length_error", 2, error_m=0.02, of="a")


def moved(made: Recording, by_row: dict[int, tuple[float, float, float]]) -> Recording:
    """The recording with some of its points elsewhere."""
    rows = list(made.rows)
    for row, (dx, dy, dz) in by_row.items():
        one = rows[row]
        assert isinstance(one, StaticPoint)
        rows[row] = replace(one, x_m=one.x_m + dx, y_m=one.y_m + dy, z_m=one.z_m + dz)
    return replace(made, rows=tuple(rows))


@pytest.mark.parametrize("toml", [MACHINE_TOML + POINTS, FREE], ids=["known", "free"])
def test_two_wrong_rows_are_named_and_the_rest_tells_what_it_told(toml: str) -> None:
    made = static_recording(LONG, toml)
    whole = examined(moved(made, {11: (0.0, 0.0, 0.5), 50: (0.06, 0.0, 0.0)}))
    (finding,) = [one for one in whole.findings if one.code == "outlying_points"]
    assert finding.count == 2
    assert "elbow in pose 5 by 0." in finding.text
    assert "tip in pose 25 by 0." in finding.text
    found = answer_json(budget_of(whole))
    assert found["verdict"] == "effects", found["why"]
    (effect,) = likely(found)
    assert (effect["name"], effect["joint"]) == ("link_length_error", 2)
    assert effect["parameters"]["error_m"]["value"] == pytest.approx(0.02, abs=5e-4)


@pytest.mark.parametrize(
    "sets",
    [
        neutral_sets(6),
        LONG,
        packed("encoder_bias", 3, bias_rad=0.1),
        packed("backlash", 2, width_rad=0.02),
        packed("gravity_sag", 2, compliance_rad_nm=1e-5),
        packed("encoder_eccentricity", 4, amplitude_rad=0.03, order=2, phase_rad=0.3),
        packed("joint_axis_tilt", 3, tilt_rad=0.05, about="x"),
    ],
)
@pytest.mark.parametrize("toml", [MACHINE_TOML + POINTS, FREE], ids=["known", "free"])
def test_what_an_effect_does_is_never_left_out(sets: ParameterSets, toml: str) -> None:
    assert not examined(static_recording(sets, toml)).findings


def test_a_model_that_is_wrong_in_many_places_leaves_all_its_points() -> None:
    rng = np.random.default_rng(2)
    many = {int(row): tuple(rng.normal(0.0, 0.3, 3)) for row in rng.choice(80, 12, replace=False)}
    assert not examined(moved(static_recording(neutral_sets(6)), many)).findings


def test_the_tail_of_what_all_poses_share_stays() -> None:
    """Play at the hand puts a few poses off, each by a little less than the one before: none of them is wild."""
    tail = {7 * k: (0.006 * 0.85**k, 0.0, 0.0) for k in range(9)}
    made = moved(static_recording(neutral_sets(6)), tail)
    assert not examined(made).findings
    (finding,) = examined(moved(made, {33: (0.0, 0.2, 0.0)})).findings  # that one is
    assert finding.count == 1
