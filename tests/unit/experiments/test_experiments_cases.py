"""Recordings that two effects explain: what is proposed is executed by the bench's own plant, and tells them apart."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.diagnosis.experiments.arm import Truth
from benchmarks.diagnosis.experiments.cases import NAMES, PAIRS, draw
from benchmarks.diagnosis.experiments.run import alone, apart, run_case
from diagnosis.behind.views_one_eye import planar_pose
from diagnosis.cells.merged import merged_cells
from diagnosis.errors import DiagnosisError
from diagnosis.reading.read import examine_recording
from diagnosis.reading.together import join_recordings
from diagnosis.replay.merge import merge_of
from diagnosis.replay.replayer import replayer_of
from machine.effects.layout import neutral_sets
from machine.markers import marker_corners
from machine.rotations import rotation_from_rotvec
from recording.rows import StaticPoint


def test_bias_and_sag_are_distinguished_by_the_proposed_postures():
    found = run_case("sag-bias", 1)
    assert found.ambiguous
    assert set(found.separates) == {"gravity_sag", "encoder_bias"}
    assert found.what == "postures across the range"
    assert found.separated
    assert found.best_both == ["encoder_bias 2"]


@pytest.mark.parametrize("pair", list(PAIRS))
def test_even_seeds_have_the_first_effect_of_a_pair_and_odd_ones_the_second(pair: str):
    truths = [draw(pair, seed).rig.truth for seed in (0, 1)]
    assert tuple((one.name, one.joint) for one in truths) == NAMES[pair]


def test_an_effect_next_to_the_true_one_leaves_the_rival_apart():
    truth = Truth("flow_gain_error", 2)
    stated = {("flow_gain_error", 2): 0.9, ("valve_lag", 1): 0.5, ("load_droop", 2): 0.2}
    effects = [{"name": name, "joint": joint, "probability": p} for (name, joint), p in stated.items()]
    result = {"budget": {"effects": effects}}
    assert apart(result, truth, {("load_droop", 2)}) == pytest.approx(0.72)
    assert alone(result, truth) == pytest.approx(0.36)


def test_without_reference_and_command_link_controller_and_actuator_are_one_cell():
    whole = examine_recording(draw("lag-delay", 0).first, Path("made up"))
    merge = merge_of(whole.stretches)
    assert merge is not None
    assert merge.stages == ("link", "controller", "actuator")
    replayer = replayer_of(whole.nominal_machine, whole.stretches)
    assert replayer is not None
    (cell,), coupled = merged_cells(replayer, whole.stretches, neutral_sets(2))
    assert coupled is None  # the one cell holds all joints already
    assert {("transport_delay", None), ("valve_lag", 2)} <= {term.effect_and_joint for term in cell.candidates}
    assert cell.floor_known


def test_a_pose_comes_back_from_one_marker_in_one_eye():
    R, t = rotation_from_rotvec(np.array([0.3, -0.2, 0.1])) @ np.diag([1.0, -1.0, -1.0]), np.array([0.2, -0.1, 1.7])
    points = marker_corners(0.3)
    at = points @ R.T + t
    T = planar_pose(points, at[:, :2] / at[:, 2:])
    assert np.allclose(T[:3, :3], R, atol=1e-9)
    assert np.allclose(T[:3, 3], t, atol=1e-9)


def test_together_lays_recordings_end_to_end():
    first = draw("sag-bias", 2).first
    both = join_recordings([first, first])
    indices = [row.pose_index for row in both.of(StaticPoint)]
    assert len(indices) == 2 * len(first.of(StaticPoint))
    assert len(set(indices)) == len(indices)


def test_together_refuses_another_machine():
    first = draw("sag-bias", 2).first
    other = replace(first, machine_toml=first.machine_toml + "\n# changed\n")
    with pytest.raises(DiagnosisError, match=r"another machine\.toml"):
        join_recordings([first, other])


def test_together_refuses_clocks_known_in_one_only():
    first = draw("sag-bias", 2).first
    other = replace(first, run_info=replace(first.run_info, plc_to_pc_offset_s=None))
    with pytest.raises(DiagnosisError, match="plc_to_pc_offset_s is missing in recording 2"):
        join_recordings([first, other])
