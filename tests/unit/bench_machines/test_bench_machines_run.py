"""One machine watched in the fast world; variants that are taken back; runs that are saved and resumed."""

import json

import numpy as np
import pytest

from benchmarks.positioning.machines.machine_run import MachineRun
from benchmarks.positioning.machines.saved import VARIANTS, Order, read_runs, run_machines, run_one
from benchmarks.positioning.machines.variants import ABLATIONS, Replacement, Variant, applied
from benchmarks.positioning.machines.watched import LookChange
from server.calibration import joint_estimate
from server.jobs.plans import driving, learning, planning
from server.jobs.requests import TakeLook

SEED = 7001


@pytest.fixture(scope="module")
def one():
    return run_one(Order("realistic"), SEED)


def test_the_default_is_inside_after_one_move_and_keeps_its_distances(one):
    assert one.state == "done", one.reason
    assert one.inside(1)
    assert one.obeys
    assert 0.3 < one.last_look_goal_m < 1.0
    assert one.path_ooi_m > one.path_goal_m - 0.1


def test_what_was_predicted_agrees_with_the_jobs_own_record(one):
    move = one.moves[0]
    assert np.sqrt(np.diag(move.covariance_mm2)) == pytest.approx(move.sigma_mm, rel=1e-3)


def test_the_time_is_that_of_the_job_and_its_looks(one):
    assert 20.0 < one.rest_s < 120.0


def test_a_run_survives_its_file(one):
    assert MachineRun.from_dict(json.loads(json.dumps(one.to_dict()))).moves[0].sigma_mm == list(one.moves[0].sigma_mm)


def test_a_second_run_reads_what_is_saved_and_mends_a_broken_line(tmp_path, one):
    file = tmp_path / Order("realistic").file_name
    file.write_text(json.dumps(one.to_dict()) + "\n" + '{"seed": 7002, "pres', encoding="utf-8")
    assert [run.seed for run in read_runs(file)] == [SEED]
    done = []
    again = run_machines(Order("realistic"), [SEED], tmp_path, advance=done.append)
    assert again[0].rest_s == one.rest_s
    assert sum(done) == 1


def test_every_variant_takes_its_replacements_back():
    before = (learning.JointPrior, planning.plan_approach, driving.worth_trimming)
    for variant in ABLATIONS:
        with applied(variant):
            pass
    assert (learning.JointPrior, planning.plan_approach, driving.worth_trimming) == before
    assert before[0] is joint_estimate.JointPrior


def test_a_replacement_for_what_is_not_there_fails():
    gone = Variant("gone", "", replaced=(Replacement(driving, "no_such_function", print),))
    with pytest.raises(AttributeError), applied(gone):
        pass


def test_names_and_files_of_variants_differ():
    names = [variant.name for variant in ABLATIONS]
    assert len(set(names)) == len(names)
    assert len({Order("realistic", name).file_name for name in VARIANTS}) == len(VARIANTS)


def test_a_look_change_leaves_the_rest_as_asked():
    assert LookChange().of(TakeLook(20)) == TakeLook(20)
    assert LookChange(pairs=1, mono=True).of(TakeLook(20)) == TakeLook(1, "mono")


def test_without_play_in_the_estimate_the_machine_contradicts_it_and_no_move_is_made():
    without, default = (run_one(Order("realistic", variant), 7002) for variant in ("no play", "default"))
    assert max(abs(v) for v in default.moves[0].true_mm[:2]) < 5.0
    assert (without.state, without.moves) == ("refused", [])
