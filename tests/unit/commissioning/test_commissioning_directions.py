"""Which way the tool goes, in words, against geometry known by hand; and the camera's axes in all 48 mountings."""

from itertools import permutations, product

import numpy as np
import pytest
from commissioning_states import CHAIN, Q

from server.commissioning.camera_axes import DIRECTION_ERROR_MAX_DEG, CameraDisplacements, axes_figures, wrong_mounting
from server.commissioning.joint_signs import (
    ExpectedDirection,
    expected_motion,
    is_expected_direction,
    parse_direction,
    person_axes,
)

STEP = float(np.deg2rad(2.0))


@pytest.mark.parametrize("slew_deg", [-120.0, 0.0, 90.0, 170.0])
def test_positive_slew_is_counter_clockwise_from_above_so_left(slew_deg):
    q = Q.copy()
    q[0] = np.deg2rad(slew_deg)
    assert expected_motion(CHAIN, q, 0, STEP).accepted_words == ("left",)
    assert expected_motion(CHAIN, q, 0, -STEP).accepted_words == ("right",)


def test_positive_lift_goes_up():
    assert expected_motion(CHAIN, Q, 1, STEP).accepted_words[0] == "up"
    assert expected_motion(CHAIN, Q, 1, -STEP).accepted_words[0] == "down"


def test_a_boom_that_hangs_tilts_out_and_up():
    assert set(expected_motion(CHAIN, Q, 2, STEP).accepted_words) == {"up", "out"}


def test_the_last_wrist_joint_turns_the_tool_about_its_own_line():
    expected = expected_motion(CHAIN, Q, 5, float(np.deg2rad(6.0)))
    back = expected_motion(CHAIN, Q, 5, float(-np.deg2rad(6.0)))
    assert {expected.accepted_words[0], back.accepted_words[0]} == {"clockwise", "counter-clockwise"}
    assert "6.0 deg" in expected.text


def test_a_tool_above_the_column_still_has_directions():
    axes = person_axes(np.eye(4))
    assert np.allclose(axes @ axes.T, np.eye(3))
    assert np.linalg.det(axes) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("answer", "word"),
    [("Left", "left"), (" ccw ", "counter-clockwise"), ("u", "up"), ("clockwise", "clockwise"), ("north", None)],
)
def test_answers_are_understood(answer, word):
    assert parse_direction(answer) == word


def test_an_answer_fits_contradicts_or_tells_nothing():
    expected = ExpectedDirection(("up", "out"), "")
    assert is_expected_direction(expected, "out") is True
    assert is_expected_direction(expected, "down") is False
    assert is_expected_direction(expected, "left") is None


# --- camera ---------------------------------------------------------------------------------------------------------

LEGS = 0.08 * np.array([[1.0, 0.05, 0.0], [0.0, -1.0, 0.1], [0.05, 0.0, -1.0]])
NAMES = ["right", "down", "back"]


def shown(seen):
    return CameraDisplacements("test", LEGS, np.asarray(seen))


def test_a_true_camera_passes_and_nothing_is_named():
    tilted = LEGS @ np.array([[1, 0, 0], [0, np.cos(0.1), -np.sin(0.1)], [0, np.sin(0.1), np.cos(0.1)]])
    assert all(figure.ok for figure in axes_figures(shown(tilted), NAMES))
    assert wrong_mounting(shown(tilted)) == ""


@pytest.mark.parametrize(
    ("turn", "told"),
    [
        (np.diag([-1.0, -1.0, 1.0]), "upside down"),
        (np.diag([-1.0, 1.0, 1.0]), "left and right"),
        (np.diag([1.0, -1.0, 1.0]), "flipped top to bottom"),
        (np.diag([-1.0, 1.0, -1.0]), "backwards"),
        (np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), "turned by 90 deg"),
    ],
)
def test_a_wrong_mounting_fails_and_is_named(turn, told):
    seen = shown(LEGS @ turn.T)
    assert not all(figure.ok for figure in axes_figures(seen, NAMES))
    assert told in wrong_mounting(seen)


@pytest.mark.parametrize("order", list(permutations(range(3))))
@pytest.mark.parametrize("signs", list(product((1.0, -1.0), repeat=3)))
def test_every_other_mounting_of_the_48_is_noticed(order, signs):
    rng = np.random.default_rng(5)
    seen = shown(LEGS[:, order] * np.array(signs) + rng.normal(0.0, 0.003, LEGS.shape))
    is_true = order == (0, 1, 2) and signs == (1.0, 1.0, 1.0)
    assert all(figure.ok for figure in axes_figures(seen, NAMES)) is is_true
    assert (wrong_mounting(seen) == "") is is_true


@pytest.mark.parametrize(("deg", "ok"), [(DIRECTION_ERROR_MAX_DEG - 1.0, True), (DIRECTION_ERROR_MAX_DEG + 1.0, False)])
def test_the_angle_is_held_to_its_limit(deg, ok):
    a = np.deg2rad(deg)
    leg = np.array([[0.08, 0.0, 0.0]])
    seen = CameraDisplacements("test", leg, 0.08 * np.array([[np.cos(a), np.sin(a), 0.0]]))
    assert axes_figures(seen, ["right"])[0].ok is ok


@pytest.mark.parametrize(("ratio", "ok"), [(0.75, False), (0.85, True), (1.2, True), (1.3, False)])
def test_the_length_is_held_to_its_limits(ratio, ok):
    assert axes_figures(shown(ratio * LEGS), NAMES)[1].ok is ok
