"""The next experiment as a plan: what is refused before anything moves, what is driven, and what follows it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_jobs_plans import CHAIN, MACHINE, Q_START, World, context, run

from recording.clock import mono_s
from server.api.views import ExperimentRequest, PlanExperimentRequest
from server.errors import JobFailedError, PlanRefusedError
from server.jobs.diagnosing import Diagnosis
from server.jobs.engine import Job, JobState
from server.jobs.experiments import Experiments
from server.jobs.plans.experimenting import AskedExperiment, check_experiment, drive_experiment, plan_experiment
from server.jobs.proposals import LooksProposal, MotionProposal, machine_text_in, proposal_of, separated_by
from server.jobs.requests import Arm, BeginSegment, EndSegment, Move, TakeLook

ID = "0123456789ab"
TEXT = '[machine]\nname = "hiab033"\n'


def motion(size_rad=0.03, joint=6, start=Q_START, seconds=8.0, **changed):
    """What a diagnosis puts under `execute`: one joint there and back, every 0.1 s."""
    t = np.arange(0.0, seconds + 0.05, 0.1)
    u = np.clip(np.minimum(t, t[-1] - t) / 2.0, 0.0, 1.0)
    course = start[joint - 1] + size_rad * (10 * u**3 - 15 * u**4 + 6 * u**5) * np.sin(1.5 * t)
    description = {
        "kind": "motion",
        "name": "steps",
        "segment_kind": "steps",
        "start_rad": start.tolist(),
        "t_knot_s": 0.1,
        "joints": [joint],
        "q_rad": course[:, None].tolist(),
    }
    return description | changed


def looks(count=3):
    postures = np.tile(Q_START, (count, 1)) + 0.02 * np.arange(count)[:, None]
    return {"kind": "looks", "name": "two distances", "q_rad": postures.tolist(), "look_s": 12.0, "from_below": True}


def answer(execute, what="steps", **more):
    pair = [{"name": "valve_lag", "joint": 6}, {"name": "transport_delay", "joint": None}]
    return {"next_experiment": {"what": what, "execute": execute, "separates": pair, "why": "both fit"} | more}


def asked(execute, recordings=(), wall_free=True, keep=None):
    proposal = proposal_of(answer(execute), 6)
    return AskedExperiment(ID, proposal, ("valve_lag on joint 6",), recordings, TEXT, wall_free, keep)


def planned(ctx, world, execute, **options):
    """The plan that is kept, and what was told of it."""
    kept = []
    told, _ = run(plan_experiment(ctx, asked(execute, **options), kept.append, lambda: world.t_ns), world)
    return kept[0], told


def performed(plan, world):
    """Everything that a plan asked for, and its result."""
    requests, reply = [], None
    while True:
        try:
            request = plan.send(reply)
        except StopIteration as end:
            return requests, end.value
        requests.append(request)
        reply = world.perform(request)


def test_an_answer_is_read_back():
    found = proposal_of(answer(motion()), 6)
    assert isinstance(found, MotionProposal)
    assert found.course().shape == (81, 6)
    assert np.array_equal(found.course()[:, :5], np.tile(Q_START[:5], (81, 1)))
    assert isinstance(proposal_of(answer(looks()), 6), LooksProposal)
    assert separated_by(answer(motion())) == ("valve_lag on joint 6", "transport_delay")


@pytest.mark.parametrize(
    ("given", "code", "text"),
    [
        ({"next_experiment": {"what": None, "why": "nothing is left to separate"}}, "no_experiment", "nothing is left"),
        ({}, "no_experiment", "names none"),
        (answer(None, "look at a marker", signal="a marker"), "experiment_not_drivable", "a marker"),
        (answer({"kind": "valve_level", "u": [0.1]}), "experiment_not_drivable", "no valve or pump directly"),
        (answer(["no", "dict"]), "experiment_not_drivable", "of kind 'None'"),
        (answer(motion(start=np.zeros(5), joint=2)), "other_machine", "5 joints, this machine has 6"),
        (answer(motion(q_rad=[[0.0, 0.1]] * 9)), "experiment_not_drivable", "cannot be read"),
        (answer(motion(joints=[7])), "experiment_not_drivable", "cannot be read"),
        (answer(motion(q_rad=[[float("nan")]] * 9)), "experiment_not_drivable", "cannot be read"),
        (answer(motion(surprise=1)), "experiment_not_drivable", "cannot be read"),
    ],
)
def test_what_cannot_be_driven_is_refused_with_its_reason(given, code, text):
    with pytest.raises(JobFailedError, match=text) as refused:
        proposal_of(given, 6)
    assert refused.value.code == code


def test_planning_moves_nothing_and_tells_what_would_be_driven():
    world, ctx = World(), context()
    plan, told = planned(ctx, world, motion())
    assert world.moved == 0
    assert told.plan_hash == plan.plan_hash
    assert told.expires_in_s == pytest.approx(60.0)
    assert told.size_frac == 1.0
    assert told.tcp_speed_max_mm_s <= 150.0
    assert told.clearance_mm is None
    assert "clearance was not checked" in told.caution
    assert planned(ctx, world, motion())[0].plan_hash == plan.plan_hash
    assert planned(ctx, world, motion(size_rad=0.031))[0].plan_hash != plan.plan_hash


def test_without_a_known_wall_somebody_has_to_say_that_there_is_none():
    world, ctx = World(), context()
    with pytest.raises(JobFailedError, match="no wall is known") as refused:
        planned(ctx, world, motion(), wall_free=False)
    assert refused.value.code == "no_wall"
    ctx.knowledge.T_base_ooi = world.T_base_ooi
    assert planned(ctx, world, motion(), wall_free=False)[1].clearance_mm > 50.0


def towards(world, metres):
    """A wall that far in front of the tool."""
    T = world.tool()
    wall = T.copy()
    wall[:3, 3] -= metres * T[:3, 2]
    return wall


def test_the_wall_and_a_range_refuse():
    world, ctx = World(), context()
    ctx.knowledge.T_base_ooi = towards(world, 0.06)  # 60 mm away, 50 mm must stay
    with pytest.raises(JobFailedError, match="from the wall") as refused:
        planned(ctx, world, motion(size_rad=0.05, joint=3), keep="size")
    assert refused.value.code == "plan_wall"
    far = Q_START.copy()
    far[1] = MACHINE.joints[1].q_max_rad - 0.01
    with pytest.raises(JobFailedError, match="limit") as refused:
        planned(context(), world, motion(size_rad=0.05, joint=2, start=far))
    assert refused.value.code == "plan_joint_limit"


def test_a_wall_that_a_look_has_found_since_refuses_the_kept_plan():
    world, ctx = World(), context()
    plan, _ = planned(ctx, world, motion(size_rad=0.05, joint=3), keep="size", wall_free=True)
    ctx.knowledge.T_base_ooi = towards(world, 0.06)
    with pytest.raises(JobFailedError, match="from the wall") as refused:
        performed(drive_experiment(ctx, plan), world)
    assert (refused.value.code, world.moved) == ("plan_wall", 0)


def test_a_recording_of_another_machine_file_is_refused(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "machine.toml").write_text(TEXT)
    world, ctx = World(), context()
    assert machine_text_in(folder) == TEXT
    planned(ctx, world, motion(), recordings=(folder,))
    (folder / "machine.toml").write_text(TEXT + "# other\n")
    with pytest.raises(JobFailedError, match="another machine file") as refused:
        planned(ctx, world, motion(), recordings=(folder,))
    assert refused.value.code == "other_machine"


def test_a_motion_is_driven_from_its_start_as_one_segment():
    world, ctx = World(), context()
    there = Q_START + np.deg2rad([2.0, 1.0, -1.0, 0.0, 0.0, 3.0])
    plan, _ = planned(ctx, world, motion(start=there))
    requests, result = performed(drive_experiment(ctx, plan), world)
    assert [type(one) for one in requests if isinstance(one, Arm | Move | BeginSegment | EndSegment)] == [
        *(Arm, Move, BeginSegment, Move, EndSegment, EndSegment)
    ]
    begun = next(one for one in requests if isinstance(one, BeginSegment))
    assert (begun.name, begun.kind) == ("steps", "steps")
    driven = [one.trajectory for one in requests if isinstance(one, Move)][1]
    assert np.array_equal(driven.q[0], there)
    assert (result.plan_hash, result.segment, result.diagnosis_id) == (plan.plan_hash, "steps", ID)
    assert ctx.knowledge.q_start is not None


def test_looks_are_come_to_from_below_and_lie_in_one_segment():
    world, ctx = World(), context()
    plan, told = planned(ctx, world, looks(3))
    assert told.looks == 3
    requests, result = performed(drive_experiment(ctx, plan), world)
    moves = [one.trajectory for one in requests if isinstance(one, Move)]
    assert len(moves) == 3
    for move, posture in zip(moves, looks(3)["q_rad"], strict=True):
        last_leg = move.q[-20:]
        assert np.array_equal(move.q[-1], posture)
        assert (np.diff(last_leg, axis=0) >= -1e-12).all()
    assert sum(isinstance(one, TakeLook) for one in requests) == 3
    assert sum(isinstance(one, BeginSegment) for one in requests) == 1
    assert result.looks_good == 3


def test_a_machine_that_has_moved_since_is_not_driven():
    world, ctx = World(), context()
    plan, _ = planned(ctx, world, motion())
    world.q_ref = world.q_ref + 2e-4
    with pytest.raises(PlanRefusedError, match="moved by"):
        performed(drive_experiment(ctx, plan), world)
    assert world.moved == 0


def test_only_the_named_fresh_plan_is_executable():
    world, ctx = World(), context()
    plan, _ = planned(ctx, world, motion())
    assert check_experiment(plan, ID, plan.plan_hash, 0) is plan
    for kept, diagnosis_id, wanted, t_ns, text in (
        (None, ID, plan.plan_hash, 0, "no experiment was planned"),
        (plan, ID, "f" * 16, 0, "is not the planned one"),
        (plan, "f" * 12, plan.plan_hash, 0, "is not the planned one"),
        (plan, ID, plan.plan_hash, int(61e9), r"has expired \(limit 60 s"),
    ):
        with pytest.raises(PlanRefusedError, match=text):
            check_experiment(kept, diagnosis_id, wanted, t_ns)


class StandInDiagnoses:
    """As much of `Diagnoses` as is asked here."""

    def __init__(self, recordings, state="done"):
        self.one = Diagnosis(ID, recordings, state=state)
        self.queued = []

    def find(self, diagnosis_id):
        return self.one if diagnosis_id == ID else None

    def result(self, one):
        return answer(motion())

    def queue(self, recordings, job_id):
        self.queued.append((recordings, job_id))
        return Diagnosis("a" * 12, recordings, job_id)


CELL = SimpleNamespace(machine=MACHINE, machine_text=TEXT)


def test_diagnoses_that_are_unknown_or_not_done_are_refused(tmp_path):
    body = PlanExperimentRequest(kind="plan_experiment", diagnosis_id=ID)
    assert Experiments(StandInDiagnoses((tmp_path,))).asked(body, CELL).recordings == (tmp_path,)
    for state in ("running", "waiting", "failed", "stopped"):
        with pytest.raises(JobFailedError, match=f"is {state}"):
            Experiments(StandInDiagnoses((tmp_path,), state)).asked(body, CELL)
    with pytest.raises(JobFailedError, match="no diagnosis"):
        Experiments(StandInDiagnoses(())).asked(body.model_copy(update={"diagnosis_id": "f" * 12}), CELL)


def test_what_was_driven_is_diagnosed_together_with_the_first(tmp_path):
    diagnoses, world, ctx = StandInDiagnoses((tmp_path / "a.mcap",)), World(), context()
    desk = Experiments(diagnoses)
    plan, _ = planned(ctx, world, motion())
    desk.keep(plan)
    body = ExperimentRequest(kind="experiment", diagnosis_id=ID, plan_hash=plan.plan_hash)
    now = world.t_ns
    _, result = performed(drive_experiment(ctx, desk.executable(body, now)), world)
    job = Job("b" * 12, "experiment", "anna", JobState.DONE, result=result)
    desk.follow(job, tmp_path / "b.mcap")
    assert diagnoses.queued == [((tmp_path / "a.mcap", tmp_path / "b.mcap"), job.job_id)]
    assert job.result.followed_by == "a" * 12
    with pytest.raises(PlanRefusedError, match="no experiment was planned"):
        desk.executable(body, now)


def test_an_experiment_that_was_stopped_or_not_recorded_is_not_diagnosed(tmp_path):
    diagnoses, world, ctx = StandInDiagnoses((tmp_path / "a.mcap",)), World(), context()
    desk = Experiments(diagnoses)
    plan, _ = planned(ctx, world, motion())
    _, result = performed(drive_experiment(ctx, plan), world)
    stopped = Job("b" * 12, "experiment", "anna", JobState.STOPPED, started_mono_s=mono_s())
    desk.follow(stopped, tmp_path / "b.mcap")
    assert stopped.result is None
    unrecorded = replace(stopped, state=JobState.DONE, result=result)
    desk.follow(unrecorded, None)
    assert unrecorded.result.not_followed == "there is no recording of it"
    assert diagnoses.queued == []
    assert CHAIN.n == 6
