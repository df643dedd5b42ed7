"""The plans without a machine: a stand-in world moves by the nominal kinematics and looks through a wrong mount."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from machine.chain import chain_of
from machine.description import parse_machine_toml
from machine.inverse import inverse_nearest
from machine.kinematics import tcp_pose
from machine.poses import inverse_pose, pose
from machine.rotations import rotation_from_rotvec
from server.calibration.contracts import CameraTrack, EncoderTrack
from server.errors import JobFailedError, PlanRefusedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import Knowledge
from server.jobs.plans.calibrating import calibrate
from server.jobs.plans.looking import good_look, take_look
from server.jobs.plans.moving import check_executable, execute, preview
from server.jobs.plans.positioning import position
from server.jobs.plans.returning import park, retract, return_to_start
from server.jobs.plans.unmoved import require_unmoved
from server.jobs.requests import (
    MachineReading,
    Move,
    PairTiming,
    Progress,
    ReadMachine,
    Record,
    Settle,
    StartOdometry,
    StopOdometry,
    TakeLook,
    TimePairs,
)
from server.motion.contracts import evaluate_trajectory
from server.settings import ServerSettings
from server.vision.contracts import Look, LookStatus

MACHINE = parse_machine_toml((files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8"))
CHAIN = chain_of(MACHINE)
Q_START = np.deg2rad([10.0, 42.0, -85.0, 4.0, -43.0, 3.0])
MOUNT_ERROR = rotation_from_rotvec(np.deg2rad([4.0, -1.0, 0.5]))


class World:
    """Joints follow the reference but for a stall; the camera is mounted 4 deg off and looks without noise."""

    def __init__(self, stall_deg=0.3, start_deg=(4.0, -3.0, 5.0)):
        self.q_ref = Q_START.copy()
        self.stall = np.deg2rad(stall_deg)
        self.q = Q_START.copy()
        self.t_ns, self.odometry_from = 0, 0
        self.T_tcp_cam = MACHINE.T_tcp_cam_left.copy()
        self.T_tcp_cam[:3, :3] = self.T_tcp_cam[:3, :3] @ MOUNT_ERROR
        T_ooi_tool = pose(rotation_from_rotvec(np.deg2rad(start_deg)), np.array([0.08, -0.05, 0.55]))
        self.T_base_ooi = self.tool() @ inverse_pose(T_ooi_tool)
        self.trace = []
        self.look_status = LookStatus.OK
        self.moved, self.pair_s = 0, 1.0 / 15.0

    def tool(self):
        return tcp_pose(CHAIN, self.q) @ MACHINE.T_tcp_tool

    def error_mm(self):
        T = inverse_pose(self.T_base_ooi) @ self.tool()
        return (T[:3, 3] - [0, 0, 0.1]) * 1e3

    def perform(self, request):
        match request:
            case Settle() | ReadMachine():
                return MachineReading(self.q.copy(), self.q_ref.copy(), self.t_ns, self.t_ns)
            case Move():
                return self.move(request.trajectory)
            case TakeLook():
                return self.look(request.n_pairs)
            case StartOdometry():
                self.trace.clear()
                return None
            case TimePairs():
                return PairTiming(self.pair_s)
            case StopOdometry():
                return self.tracks()
            case _:
                return None

    def move(self, trajectory):
        assert np.abs(trajectory.q[0] - self.q_ref).max() < 1e-12
        self.moved += 1
        times = np.arange(0.0, trajectory.duration_s, 0.05)
        motion = evaluate_trajectory(trajectory, times)
        for t, q_ref in zip(times, motion.q, strict=True):
            self.follow(q_ref)
            self.trace.append((self.t_ns + int(t * 1e9), self.q.copy()))
        self.follow(trajectory.q[-1])
        self.q_ref = trajectory.q[-1].copy()
        self.t_ns += int(trajectory.duration_s * 1e9)

    def follow(self, q_ref):
        """Play block: the joint stops short of the reference by the stall."""
        self.q = np.clip(self.q, q_ref - self.stall, q_ref + self.stall)

    def look(self, pairs):
        T_cam_base = inverse_pose(tcp_pose(CHAIN, self.q) @ self.T_tcp_cam)
        sigma = np.diag([1e-3] * 3 + [2e-4] * 3) ** 2
        if self.look_status is not LookStatus.OK:
            return Look(self.look_status, "cover is on", None, None, None, None, pairs, 0, 0, 0, 0.0)
        tool, ooi = T_cam_base @ self.tool(), T_cam_base @ self.T_base_ooi
        return Look(LookStatus.OK, "", tool, ooi, sigma, sigma, pairs, pairs, 0, 0, 0.1)

    def tracks(self):
        times = np.array([t for t, _ in self.trace]) * 1e-9
        qs = np.array([q for _, q in self.trace])
        tcp = np.array([tcp_pose(CHAIN, q) for q in qs])
        cams = tcp @ self.T_tcp_cam
        return CameraTrack(times, inverse_pose(cams[0]) @ cams), EncoderTrack(times, tcp, qs)


def context(**position_settings):
    settings = ServerSettings.model_validate({"position": position_settings})
    return PlanContext(MACHINE, CHAIN, settings, Knowledge())


def run(plan, world):
    story, reply = [], None
    while True:
        try:
            request = plan.send(reply)
        except StopIteration as end:
            return end.value, story
        if isinstance(request, (Progress, Record)):
            story.append(request)
            reply = None
        else:
            reply = world.perform(request)


def test_the_whole_loop_reaches_the_goal_despite_mount_error_and_stall():
    world, ctx = World(), context()
    result, _ = run(position(ctx, recalibrate=True, clock_ns=lambda: world.t_ns), world)
    assert result.reached, result.reason
    assert np.abs(world.error_mm()).max() < 3.0
    assert result.calibration is not None
    assert result.calibration.from_nominal_deg == pytest.approx(4.15, abs=0.3)
    assert 1 <= sum(move.kind == "move" for move in result.moves) <= 3
    assert [name for name, _ in result.seconds_by_step][:3] == ["look", "orient", "calibrate"]


def test_a_slow_camera_slows_the_calibration_and_a_standing_one_refuses_it_before_it_is_driven():
    taken, _ = run(good_look(context()), World())
    durations = {}
    for pair_s in (1.0 / 15.0, 0.33):
        world, ctx = World(), context()
        world.pair_s = pair_s
        record, story = run(calibrate(ctx, taken), world)
        durations[pair_s] = record.duration_s
        assert ("slowed from" in " ".join(getattr(told, "text", "") for told in story)) == (pair_s > 0.1)
    assert durations[0.33] > 1.5 * durations[1.0 / 15.0]
    world, ctx = World(), context()
    world.pair_s = 4.0
    with pytest.raises(JobFailedError, match=r"a pair every 4\.00 s.*relieve the computer"):
        run(calibrate(ctx, taken), world)
    assert world.moved == 0


def test_the_papers_method_trusts_the_mount_and_misses_first():
    world, ctx = World(start_deg=(1.0, 1.0, 1.0)), context().with_method("paper")
    result, _ = run(position(ctx, recalibrate=True, clock_ns=lambda: world.t_ns), world)
    moves = [move for move in result.moves if move.kind == "move"]
    assert abs(moves[0].after.camera_y_mm) > 10.0
    assert abs(moves[1].after.camera_y_mm) < 5.0


def test_a_failed_look_is_a_record_and_never_a_zero():
    world, ctx = World(), context()
    world.look_status = LookStatus.OOI_NOT_SEEN
    taken, _ = run(take_look(ctx), world)
    assert taken.error is None
    assert taken.record.status == "ooi_not_seen"
    with pytest.raises(JobFailedError, match="cover is on") as failure:
        run(good_look(ctx), world)
    assert failure.value.code == "look_ooi_not_seen"
    with pytest.raises(JobFailedError, match="look again"):
        preview(ctx, taken, 0)


def previewed():
    world, ctx = World(), context()
    taken, _ = run(good_look(ctx), world)
    return world, ctx, preview(ctx, taken, t_now_ns=0)


def test_preview_moves_nothing_and_execute_fires_it_once():
    world, ctx, plan = previewed()
    assert world.moved == 0
    run(execute(ctx, check_executable(ctx.knowledge.previewed_plan, plan.plan_hash, 10), 1), world)
    assert world.moved >= 1
    with pytest.raises(PlanRefusedError, match="no plan was previewed"):
        check_executable(ctx.knowledge.previewed_plan, plan.plan_hash, 10)


def test_a_new_look_ends_the_plan_made_from_the_one_before():
    world, ctx, plan = previewed()
    run(take_look(ctx), world)
    with pytest.raises(PlanRefusedError, match="since the last look"):
        check_executable(ctx.knowledge.previewed_plan, plan.plan_hash, 10)


def test_another_hash_an_expired_plan_and_a_moved_machine_are_refused():
    world, ctx, plan = previewed()
    with pytest.raises(PlanRefusedError, match="is not the previewed one"):
        check_executable(plan, "0" * 16, 10)
    with pytest.raises(PlanRefusedError, match=r"has expired \(limit 60 s, \[position\] plan_expires_s\)"):
        check_executable(plan, plan.plan_hash, plan.expires_ns + 1)
    world.q_ref = world.q_ref + 1e-3
    with pytest.raises(PlanRefusedError, match="reference moved"):
        run(execute(ctx, plan, 1), world)
    assert world.moved == 0


def test_a_few_counts_between_preview_and_execute_do_not_matter():
    world, ctx, plan = previewed()
    count_rad = 2.0 * np.pi / MACHINE.joints[1].encoder_counts_rev
    world.q_ref = world.q_ref + 2.0 * count_rad  # disarmed, the reference is what the encoders say
    require_unmoved(ctx.machine, world.perform(ReadMachine()), plan)
    world.q_ref = plan.q_ref_start + 6.0 * count_rad
    with pytest.raises(PlanRefusedError, match="reference moved"):
        require_unmoved(ctx.machine, world.perform(ReadMachine()), plan)


def test_a_joint_that_sank_after_the_look_is_named_and_nothing_moves():
    world, ctx, plan = previewed()
    world.q = plan.q_look - np.deg2rad([0.0, 0.1, 0.0, 0.0, 0.0, 0.0])
    require_unmoved(ctx.machine, world.perform(ReadMachine()), plan)
    world.q = plan.q_look - np.deg2rad([0.0, 0.13, 0.0, 0.0, 0.0, 0.0])  # held: the reference is where it was
    told = r"lift moved by -0\.130 deg since the look \(limit 0\.115 deg\); look again"
    with pytest.raises(PlanRefusedError, match=told):
        run(execute(ctx, plan, 1), world)
    assert world.moved == 0


def test_a_target_out_of_reach_is_named_and_nothing_moves():
    world, ctx = World(), context()
    world.T_base_ooi = pose(world.T_base_ooi[:3, :3], world.T_base_ooi[:3, 3] + np.array([2.5, 0.0, 0.0]))
    taken, _ = run(good_look(ctx), world)
    with pytest.raises(JobFailedError, match=r"reach|joint|stretch") as failure:
        preview(ctx, taken, 0)
    assert failure.value.code.startswith("plan_")
    assert world.moved == 0


def test_a_goal_inside_the_wall_is_refused():
    world, ctx = World(), context(stand_off_mm=60.0, wall_clearance_mm=120.0)
    taken, _ = run(good_look(ctx), world)
    with pytest.raises(JobFailedError, match="wall"):
        preview(ctx, taken, 0)


def test_retract_backs_away_and_return_goes_back():
    world, ctx = World(stall_deg=0.0), context()
    with pytest.raises(JobFailedError, match="no run has begun"):
        run(return_to_start(ctx), world)
    ctx.knowledge.q_start = world.q.copy()
    before = world.tool()[:3, 3].copy()
    run(retract(ctx, 200.0), world)
    assert np.linalg.norm(world.tool()[:3, 3] - before) == pytest.approx(0.2, abs=0.015)  # untrimmed: a stall is left
    run(return_to_start(ctx), world)
    assert np.linalg.norm(world.tool()[:3, 3] - before) < 6e-3


def test_park_goes_where_the_machine_file_says():
    world, ctx = World(stall_deg=0.0), context()
    run(park(ctx), world)
    wanted = [Q_START[0], *np.deg2rad([55.0, -125.0]), Q_START[3], np.deg2rad(-70.0), Q_START[5]]
    np.testing.assert_allclose(world.q, wanted, atol=1e-3)


def test_a_machine_whose_file_names_no_posture_is_not_parked():
    machine = replace(MACHINE, joints=tuple(replace(joint, park_rad=None) for joint in MACHINE.joints))
    world, ctx = World(), replace(context(), machine=machine)
    told = r"machine file of hiab033 names no park posture: give park_deg"
    with pytest.raises(JobFailedError, match=told) as failure:
        run(park(ctx), world)
    assert (failure.value.code, world.moved) == ("no_park_posture", 0)


def test_the_stand_in_world_is_reachable():
    T_goal = World().T_base_ooi @ pose(np.eye(3), np.array([0, 0, 0.1])) @ inverse_pose(MACHINE.T_tcp_tool)
    assert inverse_nearest(CHAIN, T_goal, Q_START).q_rad is not None
