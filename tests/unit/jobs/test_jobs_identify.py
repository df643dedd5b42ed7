"""An identification as a plan: nothing moves before it is named, a pause keeps what was driven, the rest is resumed."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_jobs_drive_steps import performed
from test_jobs_plans import World, context, run

from server.errors import JobFailedError, PlanRefusedError
from server.jobs.diagnosing import Diagnosis
from server.jobs.engine import Job, JobState
from server.jobs.identification import IDENTIFICATION_PART_NAMES, Identification, Session
from server.jobs.plans import drive_steps
from server.jobs.plans.identifying import drive_identification, plan_identification
from server.jobs.request_bodies import IdentifyRequest, PlanIdentifyRequest
from server.jobs.requests import BeginSegment, MachineReading, Move, ReadMachine, Settle, TakeLook
from server.vision.contracts import LookStatus

MINUTES = 1.5


class Desk:
    """Diagnoses that only note what was asked for."""

    def __init__(self):
        self.asked = []

    def queue_diagnosis(self, recordings, job_id):
        self.asked.append(recordings)
        return Diagnosis("d" * 12, recordings, job_id)


def planned(ctx, world, desk, resume=False, wall_free=False):
    body = PlanIdentifyRequest(kind="plan_identify", minutes=MINUTES, resume=resume, wall_free=wall_free)
    plan = plan_identification(ctx, MINUTES, wall_free, desk.drive_to_resume(body), desk.keep_plan, lambda: world.t_ns)
    told, _ = run(plan, world)
    return told


def driving(ctx, world, desk, told):
    body = IdentifyRequest(kind="identify", plan_hash=told.plan_hash)
    return drive_identification(ctx, *desk.require_fresh_plan(body, world.t_ns))


@pytest.fixture
def stage():
    world, ctx, diagnoses = World(stall_deg=0.0), context(), Desk()
    return SimpleNamespace(world=world, ctx=ctx, diagnoses=diagnoses, desk=Identification(diagnoses))


def test_a_plan_moves_nothing_and_its_hash_drives_every_part_once(stage, tmp_path):
    told = planned(stage.ctx, stage.world, stage.desk)
    assert stage.world.moved == 0
    assert [part.name for part in told.parts] == list(IDENTIFICATION_PART_NAMES)
    assert told.tcp_speed_max_mm_s <= 150.0
    assert told.clearance_mm >= 50.0
    assert any("encoder_bias of joint 1" in text for text in told.cannot)
    start = stage.world.q_ref.copy()
    requests, driven = performed(driving(stage.ctx, stage.world, stage.desk, told), stage.world)
    assert np.allclose(stage.world.q_ref, start, atol=1e-9)
    marks = [mark for request in requests if isinstance(request, Move) for mark in request.segment_marks]
    assert [mark.repeat_of for mark in marks].count("repeats") == 4
    assert {mark.kind for mark in marks} == {"repeat", "sweep", "multisine", "workcycle", "steps", "staircase", "hold"}
    assert [one.kind for one in requests if isinstance(one, BeginSegment)] == ["static"]
    assert driven.looks_good == sum(isinstance(one, TakeLook) for one in requests) == told.looks
    job = Job("a" * 12, "identify", "anna", JobState.DONE, result=driven)
    stage.desk.after_drive(job, tmp_path / "one.mcap")
    assert stage.diagnoses.asked == [(tmp_path / "one.mcap",)]
    assert job.result.followed_by == "d" * 12
    with pytest.raises(PlanRefusedError, match="no identification was planned"):
        driving(stage.ctx, stage.world, stage.desk, told)


def test_a_pause_keeps_what_was_driven_and_only_the_rest_is_planned(stage, tmp_path):
    told = planned(stage.ctx, stage.world, stage.desk)
    plan, moves, reply = driving(stage.ctx, stage.world, stage.desk, told), 0, None
    while moves < 3:  # the third motion is cut short: neither it nor what follows counts
        request = plan.send(reply)
        moves += isinstance(request, Move)
        reply = stage.world.perform(request) if moves < 3 else None
    plan.close()
    stopped = Job("a" * 12, "identify", "anna", JobState.STOPPED, reason="button up")
    stage.desk.after_drive(stopped, tmp_path / "one.mcap")
    assert stage.desk.session.done == ["repeats", "slow passes"]
    assert "6 of 8 parts remain (multisine" in stage.desk.next_step
    assert stage.diagnoses.asked == []
    rest = planned(stage.ctx, stage.world, stage.desk, resume=True)
    assert [part.name for part in rest.parts] == list(IDENTIFICATION_PART_NAMES[2:])
    _, driven = performed(driving(stage.ctx, stage.world, stage.desk, rest), stage.world)
    stage.desk.after_drive(Job("b" * 12, "identify", "anna", JobState.DONE, result=driven), tmp_path / "two.mcap")
    assert stage.diagnoses.asked == [(tmp_path / "one.mcap", tmp_path / "two.mcap")]
    assert stage.desk.next_step == ""
    with pytest.raises(JobFailedError, match="no identification is paused"):
        planned(stage.ctx, stage.world, stage.desk, resume=True)


def test_a_wall_that_is_nearer_than_thought_is_refused_before_anything_moves(stage):
    told = planned(stage.ctx, stage.world, stage.desk)
    T_base_ooi = stage.ctx.knowledge.T_base_ooi.copy()
    T_base_ooi[:3, 3] += 0.35 * T_base_ooi[:3, 2]
    stage.ctx.knowledge.T_base_ooi = T_base_ooi
    with pytest.raises(JobFailedError, match="from the wall"):
        performed(driving(stage.ctx, stage.world, stage.desk, told), stage.world)
    assert stage.world.moved == 0


def test_an_old_hash_or_another_place_is_refused(stage):
    told = planned(stage.ctx, stage.world, stage.desk)
    with pytest.raises(PlanRefusedError, match="is not the planned one"):
        driving(stage.ctx, stage.world, stage.desk, replace(told, plan_hash="0" * 16))
    stage.world.q_ref = stage.world.q_ref + 1e-3
    with pytest.raises(PlanRefusedError, match="moved by"):
        performed(driving(stage.ctx, stage.world, stage.desk, told), stage.world)


def test_where_no_marker_is_seen_the_plan_says_what_stays_open(stage):
    stage.world.look_status = LookStatus.TOOL_NOT_SEEN if hasattr(LookStatus, "TOOL_NOT_SEEN") else list(LookStatus)[1]
    with pytest.raises(JobFailedError, match="no wall is known"):
        planned(stage.ctx, stage.world, stage.desk)
    told = planned(stage.ctx, stage.world, stage.desk, wall_free=True)
    assert told.looks == 0
    assert [part.name for part in told.parts] == list(IDENTIFICATION_PART_NAMES[:-1])
    assert any("no marker of the object is visible" in text for text in told.cannot)
    assert "no wall is known" in told.caution


class Interrupted:
    """A stand-in that goes wherever it is sent; at one request, what `kind` says happens."""

    def __init__(self, world, kind, at):
        self.world, self.kind, self.at, self.count = world, kind, at, 0
        self.q_ref, self.moving = world.q_ref.copy(), False

    def perform(self, request):
        self.count += 1
        due = self.count >= self.at
        if isinstance(request, Move):
            assert np.abs(request.trajectory.q[0] - self.q_ref).max() < 1e-9
            if due and self.kind in ("stop", "e-stop"):
                raise JobFailedError("motion ended early: e-stop", "motion_ended_early")
            self.q_ref = request.trajectory.q[-1].copy()
        if due and self.kind == "plc" and isinstance(request, Settle | ReadMachine):
            raise JobFailedError("PLC state is 1200 ms old", "plc_silent")
        if isinstance(request, TakeLook):
            self.world.look_status = list(LookStatus)[1] if due and self.kind == "camera" else LookStatus.OK
            return self.world.look(request.n_pairs)
        if isinstance(request, Settle | ReadMachine):
            return MachineReading(self.q_ref.copy(), self.q_ref.copy(), self.world.t_ns, self.world.t_ns)
        return None


def test_two_hundred_interruptions_leave_whole_parts_and_a_next_step(stage, tmp_path, monkeypatch):
    monkeypatch.setattr(drive_steps, "refuse_unsafe_reference", lambda *_: None)  # it takes seconds, 200 times
    told = planned(stage.ctx, stage.world, stage.desk)
    whole, start = stage.desk.session.planned_identification, stage.world.q_ref.copy()
    length = 2 * sum(len(part.steps) for part in whole.parts) + 2 * told.looks
    rng = np.random.default_rng(57)
    for number in range(200):
        kind = ("stop", "e-stop", "plc", "camera")[number % 4]
        stage.desk.session = replace_session(stage.desk.session, whole)
        stage.world.q_ref, stage.world.q = start.copy(), start.copy()
        case = Interrupted(stage.world, kind, int(rng.integers(1, length)))
        plan, driven, reply, failed = driving(stage.ctx, stage.world, stage.desk, told), [], None, None
        while failed is None:
            try:
                request = plan.send(reply)
                driven += [request.purpose] if isinstance(request, Move) else []
                reply = case.perform(request)
            except StopIteration:
                break
            except JobFailedError as error:
                failed = error
        plan.close()
        done = stage.desk.session.done
        steps = [step.purpose for part in whole.parts if part.name in done for step in part.steps]
        assert driven[: len(steps)] == steps  # what counts as done was driven to its end
        if failed is None:
            assert done == list(IDENTIFICATION_PART_NAMES)
            continue
        stage.desk.after_drive(
            Job("a" * 12, "identify", "anna", JobState.FAILED, reason=str(failed)), tmp_path / "x.mcap"
        )
        assert "plan the rest with resume" in stage.desk.next_step
        assert stage.desk.session.remaining_parts == tuple(
            name for name in IDENTIFICATION_PART_NAMES if name not in done
        )


def replace_session(session, planned_whole):
    """The session as it was when its plan was made."""
    return Session(
        replace(session.drive, done_parts=set()), planned_whole, tuple(part.name for part in planned_whole.parts)
    )
