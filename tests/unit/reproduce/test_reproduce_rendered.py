"""Rendered cases: the placed world, the looks of both kinds of jobs, and the truth joined by PLC time."""

import csv

import numpy as np
import pytest
from reproduce_worlds import world
from rich.console import Console

from benchmarks.reproduce.fast_machine import QuasiStaticMachine, Trace
from benchmarks.reproduce.paper_setup import NoSetUpError, nearer
from benchmarks.reproduce.placed_sim import placed
from benchmarks.reproduce.rendered_cases import TRUTH, _step, looks_of, read_truth
from benchmarks.reproduce.rendered_paths import TraceHistory, tool_masks
from benchmarks.reproduce.rendered_tables import FILE, saved_rendered
from benchmarks.saved_lines import run_saved
from machine.poses import pose
from machine.rotations import rotation_from_rotvec
from sim_plc.plant.plant import Plant

ERROR = {f"{prefix}{axis}_mm": 1.0 for prefix in ("", "camera_") for axis in "xyz"} | {"rotation_deg": 0.5}


def test_the_simulated_world_is_placed_as_in_the_fast_world():
    one = world("paper", 2)
    T = Plant(one.plant, one.q_start_rad).T_base_tcp()
    np.testing.assert_array_equal(placed(one, "nearer").scene.T_base_ooi, nearer(one, T).scene.T_base_ooi)
    with pytest.raises(KeyError):
        placed(one, "elsewhere")
    assert issubclass(NoSetUpError, RuntimeError)


def test_looks_of_line_and_position_jobs():
    line = {"looks": [{"name": "move", "error": ERROR, "t_plc_ns": 7}], "note": ""}
    assert looks_of(line) == [("move", ERROR, 7)]
    moves = [
        {"kind": "orientation", "number": 1, "after": ERROR, "t_rest_plc_ns": 1},
        {"kind": "move", "number": 1, "after": None, "t_rest_plc_ns": 2},
        {"kind": "move", "number": 2, "after": ERROR, "t_rest_plc_ns": 3},
    ]
    assert [(name, t) for name, _, t in looks_of({"moves": moves})] == [("oriented", 1), ("move 2", 3)]


def truth_file(path, rows) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t_plc_ns", *TRUTH])
        writer.writerows(rows)


def test_truth_is_joined_at_the_look_and_at_the_goal_it_is_zero(tmp_path):
    path, t_ns = tmp_path / "truth.csv", 5_000_000_000_000
    at_goal = [0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0]
    far = [0.3, 0.2, 0.5, 1.0, 0.0, 0.0, 0.0]
    truth_file(
        path,
        [
            [t_ns - 350_000_000, *far],  # still coming
            [t_ns - 20_000_000, *at_goal],
            [t_ns, *at_goal],
            [t_ns + 20_000_000, *far],  # the next motion
            [t_ns, "", *[""] * 6],
        ],
    )
    truth = read_truth(path)
    assert truth.shape == (4, 8)
    step = _step(world("paper", 2), "move 1", ERROR, t_ns, truth)
    np.testing.assert_allclose(step.goal_true_mm, 0.0, atol=1e-6)
    assert step.rotation_true_deg == pytest.approx(0.0, abs=1e-5)
    assert step.camera_image_mm == (1.0, 1.0, 1.0)
    assert np.linalg.norm(step.camera_true_mm) == pytest.approx(100.0, abs=1e-6)
    with pytest.raises(ValueError, match="truth log has nothing"):
        _step(world("paper", 2), "move 1", ERROR, t_ns + 3_000_000_000, truth)


def test_saved_rendered_cases_are_sorted_by_kind(tmp_path):
    def run(key: str) -> dict[str, object]:
        kind = key.rsplit(" ", 1)[0]
        return {"seed": 1, "kind": kind, "state": "refused", "reason": "", "steps": [], "start_mm": None, "notes": {}}

    run_saved(tmp_path / FILE, ["line, fit 1", "matching, paper 1"], run, Console(quiet=True), "x")
    found = saved_rendered(tmp_path)
    assert [len(found[kind]) for kind in ("paper servo", "fit", "matching")] == [0, 1, 1]


def test_poses_between_the_rows_of_a_trace_and_the_mask_over_the_tool():
    T_a, T_b = (
        pose(np.eye(3), np.zeros(3)),
        pose(rotation_from_rotvec(np.array([0.0, 0.0, 0.2])), np.array([1.0, 0.0, 0.0])),
    )
    trace = Trace(np.array([0.0, 0.01]), np.zeros((2, 6)), np.array([T_a, T_b]))
    middle = TraceHistory(trace).pose_at(5_000_000)
    np.testing.assert_allclose(middle, pose(rotation_from_rotvec(np.array([0.0, 0.0, 0.1])), np.array([0.5, 0.0, 0.0])))
    np.testing.assert_allclose(TraceHistory(trace).pose_at(99_000_000), T_b, atol=1e-12)
    one = world("paper", 2)
    lefts, rights = tool_masks(one, QuasiStaticMachine(one).T_base_tcp())
    assert len(lefts) == 1
    assert lefts[0].shape == (4, 2)
    assert rights[0][:, 0].mean() < lefts[0][:, 0].mean()  # what is near lies further left in the right eye
