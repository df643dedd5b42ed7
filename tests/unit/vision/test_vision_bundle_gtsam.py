"""Acceptance 3.7: our optimum on gtsam's stereo data against gtsam's own, judged by a third cost function."""

import numpy as np
import pytest
from gtsam_solvers import solve_gtsam, solve_ours
from gtsam_start import disturbed_start
from gtsam_stereo_data import cost_of, gtsam_data_folder, read_stereo_data, squares_px

pytest.importorskip("gtsam", reason="gtsam is not installed: nothing to compare with")


@pytest.fixture(scope="module")
def data():
    folder = gtsam_data_folder()
    if folder is None:
        pytest.skip("this gtsam ships no example data")
    return read_stereo_data(folder)


def test_the_data_are_what_we_think(data):
    assert (len(data.Ts_vo_cam), len(data.frames)) == (26, 8189)


@pytest.mark.parametrize("huber_px", [None, 2.0])
@pytest.mark.parametrize("start", [0, 1])
def test_cost_is_within_a_thousandth_of_gtsams(data, huber_px, start):
    begun = data if start == 0 else disturbed_start(data, start)
    ours, theirs = solve_ours(begun, huber_px), solve_gtsam(begun, huber_px)
    costs = [cost_of(squares_px(data, one.Ts_vo_cam, one.points_vo), huber_px) for one in (ours, theirs)]
    begun_cost = cost_of(squares_px(begun, begun.Ts_vo_cam, begun.points_vo), huber_px)
    assert costs[1] < 0.5 * begun_cost or not np.isfinite(begun_cost)
    assert costs[0] == pytest.approx(costs[1], rel=1e-3)
    assert np.abs(ours.Ts_vo_cam - theirs.Ts_vo_cam).max() < 1e-4, "m"
