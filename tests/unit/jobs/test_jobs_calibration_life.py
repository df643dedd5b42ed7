"""The calibration's life inside the jobs: kept, watched, renewed, refused; and what is done when a move is unsure."""

import time
from dataclasses import replace

import numpy as np
import pytest
from test_jobs_plans import CHAIN, MACHINE, World, context, run

from machine.effects.entries import EffectEntry
from machine.poses import pose
from machine.rotations import rotation_from_rotvec
from recording.clock import mono_ns, mono_s
from server.calibration.calibration_file import parse_calibration
from server.calibration.calibration_life import ValidityStatus
from server.errors import JobFailedError
from server.jobs.calibration_store import CalibrationStore, machine_id_of
from server.jobs.knowledge import Knowledge
from server.jobs.plans import assurance
from server.jobs.plans.assurance import assured_preview
from server.jobs.plans.living import calibration_validity
from server.jobs.plans.looking import good_look
from server.jobs.plans.moving import execute, preview
from server.jobs.plans.positioning import position
from server.jobs.plans.returning import retract
from server.jobs.requests import Settle, StartOdometry, TakeLook

H = 3600 * 10**9


class Counted(World):
    """The stand-in world that counts what it was asked for; `tool_slip` (4, 4) turns and shifts the marker seen."""

    def __init__(self, **options):
        super().__init__(**options)
        self.paths, self.pairs, self.tool_slip = 0, [], np.eye(4)

    def perform(self, request):
        self.paths += isinstance(request, StartOdometry)
        if isinstance(request, TakeLook):
            self.pairs.append(request.n_pairs)
        reply = super().perform(request)
        if isinstance(request, TakeLook) and reply.T_cam_tool is not None:
            reply = replace(reply, T_cam_tool=reply.T_cam_tool @ self.tool_slip)
        return reply


def positioned(**settings):
    world, ctx = Counted(), context(**settings)
    result, _ = run(position(ctx, True, lambda: world.t_ns), world)
    assert result.reached, result.reason
    return world, ctx


def again(world, ctx):
    return run(position(ctx, False, lambda: world.t_ns), world)


def test_a_run_leaves_a_calibration_with_its_place_and_its_map():
    world, ctx = positioned()
    life = ctx.knowledge.kept_calibration
    assert life.valid_at(world.t_ns * 1e-9, world.q, ctx.tcp(world.q)).ok
    assert life.local_map.n_looks >= 1
    assert life.tool_marker_pose is not None
    assert np.linalg.norm(life.made_at.T_base_tcp[:3, 3] - ctx.tcp(world.q)[:3, 3]) > 0.3  # made before the move


def test_a_kept_calibration_spares_the_path():
    world, ctx = positioned()
    before = world.paths
    result, _ = again(world, ctx)
    assert result.reached
    assert world.paths == before


def test_an_old_one_is_renewed_by_the_job_and_refused_by_a_single_step():
    world, ctx = positioned()
    before = world.paths
    world.t_ns += 13 * H
    taken, _ = run(good_look(ctx), world)
    with pytest.raises(JobFailedError, match=r"13\.0 h old.*calibrate") as refused:
        preview(ctx, taken, world.t_ns)
    assert refused.value.code == "calibration_too_old"
    kept = ctx.knowledge.kept_calibration
    run(retract(ctx, 400.0), world)
    result, story = again(world, ctx)
    assert result.reached
    assert world.paths == before + 1
    assert ctx.knowledge.kept_calibration is not kept
    assert any("calibrating again" in getattr(item, "text", "") for item in story)


def slipped(world):
    world.tool_slip = pose(rotation_from_rotvec(np.deg2rad([0.0, 2.0, 0.0])), np.array([0.0, 0.004, 0.0]))


def test_after_a_slip_nothing_moves_until_somebody_calibrates():
    world, ctx = positioned()
    slipped(world)
    moved = world.moved
    with pytest.raises(JobFailedError, match=r"slipped.*tighten") as refused:
        again(world, ctx)
    assert refused.value.code == "calibration_slipped"
    assert world.moved == moved
    with pytest.raises(JobFailedError, match="slipped"):
        again(world, ctx)
    run(retract(ctx, 400.0), world)
    result, _ = run(position(ctx, True, lambda: world.t_ns), world)  # asked for a new one: it starts afresh
    assert result.calibration is not None
    assert not ctx.knowledge.kept_calibration.slip


def test_a_calibration_after_a_slip_does_not_mix_the_old_mount_with_the_new_one():
    world, ctx = positioned()
    run(retract(ctx, 400.0), world)
    world.T_tcp_cam = world.T_tcp_cam @ pose(
        rotation_from_rotvec(np.deg2rad([0.0, 4.0, 0.0])), np.array([0.0, 0.01, 0])
    )
    run(good_look(ctx), world)
    assert ctx.knowledge.kept_calibration.slip
    taken, _ = run(good_look(ctx), world)  # as told: tighten, look, calibrate, look
    run(assurance.calibrate(ctx, taken), world)
    taken, _ = run(good_look(ctx), world)
    assert (len(ctx.knowledge.odometry_runs), len(ctx.knowledge.look_observations)) == (1, 2)
    assert not ctx.knowledge.kept_calibration.slip
    run(execute(ctx, preview(ctx, taken, world.t_ns), 1), world)
    assert np.abs(world.error_mm()).max() < 3.0


def test_without_a_slip_a_further_calibration_adds_to_what_is_known():
    world, ctx, taken = calibrated()
    run(assurance.calibrate(ctx, taken), world)
    assert (len(ctx.knowledge.odometry_runs), len(ctx.knowledge.look_observations)) == (2, 2)


def test_a_slip_seen_between_preview_and_execute_stops_the_move():
    world, ctx = positioned()
    world.T_base_ooi = world.T_base_ooi @ pose(np.eye(3), np.array([0.02, 0.0, 0.0]))
    taken, _ = run(good_look(ctx), world)
    plan = preview(ctx, taken, world.t_ns)
    slipped(world)
    run(good_look(ctx), world)
    moved = world.moved
    with pytest.raises(JobFailedError, match="slipped"):
        run(execute(ctx, plan, 1), world)
    assert world.moved == moved


@pytest.mark.parametrize("deg", [0.7, 0.9])
def test_a_camera_that_turned_a_little_is_calibrated_anew_and_nobody_is_called(deg):
    """0.9 deg are 9 mm at the end of a long way; the look shows it, and the path of before is of another mount."""
    world, ctx = positioned()
    run(retract(ctx, 400.0), world)
    paths = world.paths
    about_the_marker = MACHINE.T_tcp_tool @ pose(rotation_from_rotvec(np.deg2rad([0.0, deg, 0.0])), np.zeros(3))
    world.T_tcp_cam = about_the_marker @ np.linalg.inv(MACHINE.T_tcp_tool) @ world.T_tcp_cam
    taken, _ = run(good_look(ctx), world)
    with pytest.raises(JobFailedError, match=r"small, but significant.*calibrate") as refused:
        preview(ctx, taken, world.t_ns)
    assert refused.value.code == "calibration_shifted"
    result, story = again(world, ctx)
    assert result.reached
    assert np.abs(world.error_mm()).max() < 3.0
    assert world.paths == paths + 1
    assert len(ctx.knowledge.odometry_runs) == 1
    assert any("calibrating again: the tool marker moved" in getattr(item, "text", "") for item in story)


def test_why_the_learnt_map_is_not_used_is_told():
    world, ctx = Counted(), context()
    world.T_tcp_cam[:3, :3] = MACHINE.T_tcp_cam_left[:3, :3] @ rotation_from_rotvec(np.deg2rad([0.0, 18.0, 0.0]))
    _, story = run(position(ctx, True, lambda: world.t_ns), world)
    told = [item.text for item in story if "learnt map is not used" in getattr(item, "text", "")]
    assert told
    assert "from the machine file" in told[0]


def test_what_the_papers_method_believes_of_its_mount_is_no_calibration_of_ours():
    world, ctx = Counted(), context(local_map="rigid")
    run(position(ctx.with_method("paper"), True, lambda: world.t_ns), world)
    paths = world.paths
    assert calibration_validity(ctx, world.perform(Settle())).status is ValidityStatus.OTHER_METHOD
    run(retract(ctx, 400.0), world)
    result, story = again(world, ctx)
    assert world.paths > paths
    assert result.calibration.method != "paper"
    assert any("by the paper's method" in getattr(item, "text", "") for item in story)


def test_a_path_that_has_expired_does_not_become_young_by_another_one():
    world, ctx, taken = calibrated()
    world.t_ns += 13 * H
    taken, _ = run(good_look(ctx), world)
    run(assurance.calibrate(ctx, taken), world)
    assert len(ctx.knowledge.odometry_runs) == 1


def test_the_limits_of_the_settings_are_those_that_count(tmp_path):
    world, ctx = positioned()
    file = tmp_path / "calibration.json"
    CalibrationStore(file).save_if_changed(ctx.knowledge)
    knowledge, strict = Knowledge(), replace(ctx.knowledge.kept_calibration.expiry, age_max_s=1800.0)
    CalibrationStore(file).restore(knowledge, ctx.machine_id, CHAIN.n, world.t_ns * 1e-9 + 5 * 3600.0, strict)
    assert "5.0 h old (limit 0.5 h)" in knowledge.calibration_note
    CalibrationStore(file).restore(knowledge, ctx.machine_id, CHAIN.n, world.t_ns * 1e-9, strict)
    assert knowledge.kept_calibration.expiry == strict


def test_a_calibration_is_of_its_machine_file_and_of_what_was_compensated():
    bias = EffectEntry("encoder_bias", 3, (("bias_rad", 0.004),))
    plain = machine_id_of("[machine]")
    assert machine_id_of("[machine]", ()) == plain
    assert len({plain, machine_id_of("[machine] "), machine_id_of("[machine]", (bias,))}) == 3


def test_a_number_that_cannot_be_written_ends_no_job(tmp_path):
    _, ctx = positioned()
    ctx.knowledge.kept_calibration = replace(ctx.knowledge.kept_calibration, residual_rms_mm=float("nan"))
    CalibrationStore(tmp_path / "calibration.json").save_if_changed(ctx.knowledge)
    assert "not saved" in ctx.knowledge.calibration_note


def test_the_papers_method_knows_no_slip():
    world, ctx = positioned()
    slipped(world)
    taken, _ = run(good_look(ctx.with_method("paper")), world)
    assert taken.error is not None
    assert not ctx.knowledge.kept_calibration.slip


def calibrated():
    world, ctx = Counted(), context()
    taken, _ = run(good_look(ctx), world)
    run(assurance.calibrate(ctx, taken), world)
    taken, _ = run(good_look(ctx), world)
    return world, ctx, taken


def predict(monkeypatch, *sigmas):
    """Make the predicted sigma of the next previews these values [mm], the last one for good."""
    told = list(sigmas)

    def told_preview(ctx, taken, t_now_ns):
        sigma = told.pop(0) if len(told) > 1 else told[0]
        return replace(preview(ctx, taken, t_now_ns), predicted_sigma_mm=(1.0, sigma, 1.0))

    monkeypatch.setattr(assurance, "preview", told_preview)


def test_a_sure_move_costs_nothing_more(monkeypatch):
    world, ctx, taken = calibrated()
    predict(monkeypatch, 2.5)
    asked = world.paths, len(world.pairs)
    assured, _ = run(assured_preview(ctx, taken, 0, 3), world)
    assert (world.paths, len(world.pairs)) == asked
    assert assured.n_calibration_paths == 0


def test_an_unsure_move_gets_a_further_path_first(monkeypatch):
    world, ctx, taken = calibrated()
    predict(monkeypatch, 2.6, 2.4)
    assured, story = run(assured_preview(ctx, taken, 0, 0), world)
    assert (world.paths, assured.n_calibration_paths, len(ctx.knowledge.odometry_runs)) == (2, 1, 2)
    assert any("5.2 mm (2 sigma, allowed 5)" in getattr(item, "text", "") for item in story)


def test_where_the_look_spoils_it_more_pairs_are_taken_and_no_path(monkeypatch):
    world, ctx, taken = calibrated()
    blurred = replace(taken.look, ooi_covariance=taken.look.ooi_covariance * 400.0)
    predict(monkeypatch, 2.6, 2.0)
    run(assured_preview(ctx, replace(taken, look=blurred), 0, 0), world)
    assert world.pairs[-1] == 3 * ctx.settings.look.pairs
    assert world.paths == 1


def test_what_stays_unsure_is_a_closer_look_while_a_move_is_left_and_refused_after(monkeypatch):
    world, ctx, taken = calibrated()
    predict(monkeypatch, 3.0)
    assured, story = run(assured_preview(ctx, taken, 0, 1), world)
    assert max(assured.previewed_plan.predicted_sigma_mm) == 3.0
    assert any("moving closer to look again" in getattr(item, "text", "") for item in story)
    with pytest.raises(
        JobFailedError, match=r"y known to \+-6\.0 mm .*2 calibration paths.*no move is left"
    ) as refused:
        run(assured_preview(ctx, taken, 0, 0), world)
    assert refused.value.code == "sigma_too_large"


def test_too_near_for_a_further_path_the_move_is_driven_all_the_same(monkeypatch):
    world, ctx = positioned()
    world.T_base_ooi = world.T_base_ooi @ pose(np.eye(3), np.array([0.02, 0.0, 0.0]))
    taken, _ = run(good_look(ctx), world)
    predict(monkeypatch, 3.0)
    assured, story = run(assured_preview(ctx, taken, 0, 1), world)
    assert any("no further path" in getattr(item, "text", "") for item in story)
    run(execute(ctx, assured.previewed_plan, 1), world)


def test_what_is_no_more_than_a_guess_is_refused_even_with_moves_left(monkeypatch):
    world, ctx, taken = calibrated()
    predict(monkeypatch, 8.0)
    with pytest.raises(JobFailedError, match="too little for an approach"):
        run(assured_preview(ctx, taken, 0, 3), world)
    assert world.moved == 2  # the two calibration paths


def test_kept_on_disk_it_is_taken_up_by_the_next_server(tmp_path):
    world, ctx = positioned()
    store, file = CalibrationStore(tmp_path / "runs" / "calibration.json"), tmp_path / "runs" / "calibration.json"
    store.save_if_changed(ctx.knowledge)
    assert parse_calibration(file.read_text()).calibration.n_used == ctx.knowledge.kept_calibration.n_used
    fresh = replace(ctx, knowledge=Knowledge())
    CalibrationStore(file).restore(fresh.knowledge, ctx.machine_id, CHAIN.n, world.t_ns * 1e-9)
    assert fresh.knowledge.calibration_note == ""
    paths = world.paths
    world.T_base_ooi = world.T_base_ooi @ pose(np.eye(3), np.array([0.05, -0.04, 0.0]))
    result, _ = again(world, fresh)
    assert result.reached
    assert np.abs(world.error_mm()).max() < 3.0
    assert world.paths == paths


@pytest.mark.parametrize(
    ("spoil", "word"),
    [
        (lambda text: text[: len(text) // 2], "damaged"),
        (lambda text: text.replace('"version": 1', '"version": 9'), "version 9"),
        (lambda text: "\x00\xff", "damaged"),
    ],
)
def test_a_spoilt_file_is_a_note_and_never_a_crash(tmp_path, spoil, word):
    world, ctx = positioned()
    file = tmp_path / "calibration.json"
    CalibrationStore(file).save_if_changed(ctx.knowledge)
    file.write_text(spoil(file.read_text()))
    knowledge = Knowledge()
    CalibrationStore(file).restore(knowledge, ctx.machine_id, CHAIN.n, world.t_ns * 1e-9)
    assert word in knowledge.calibration_note
    assert knowledge.mount_rotation_estimate is None


def test_another_machine_another_arm_and_an_old_file_are_not_taken_up(tmp_path):
    world, ctx = positioned()
    file = tmp_path / "calibration.json"
    CalibrationStore(file).save_if_changed(ctx.knowledge)
    now_s = world.t_ns * 1e-9
    for machine_id, n, t_s, word in (
        ("another", 6, now_s, "another machine"),
        (ctx.machine_id, 5, now_s, "6 joints, the machine 5"),
        (ctx.machine_id, 6, now_s + 13 * 3600.0, "h old"),
    ):
        knowledge = Knowledge()
        CalibrationStore(file).restore(knowledge, machine_id, n, t_s)
        assert word in knowledge.calibration_note
        assert knowledge.kept_calibration is None


def test_a_disk_that_takes_nothing_is_noted_and_ends_no_job(tmp_path):
    _, ctx = positioned()
    (tmp_path / "file").write_text("")
    CalibrationStore(tmp_path / "file" / "calibration.json").save_if_changed(ctx.knowledge)
    assert "not saved" in ctx.knowledge.calibration_note


def test_the_engine_s_clock_gives_the_age_in_calendar_time():
    ctx = context()
    ctx.knowledge.unix_minus_mono_s = time.time() - mono_s()
    assert ctx.knowledge.unix_s(mono_ns()) == pytest.approx(time.time(), abs=1.0)


def test_oil_that_became_much_warmer_ends_it():
    world, ctx = positioned()
    ctx.knowledge.kept_calibration = replace(
        ctx.knowledge.kept_calibration, made_at=replace(ctx.knowledge.kept_calibration.made_at, oil_temperature_c=30.0)
    )
    cool = replace(world.perform(Settle()), oil_temperature_c=50.0)
    assert calibration_validity(ctx, cool).ok
    assert calibration_validity(ctx, replace(cool, oil_temperature_c=60.0)).status is ValidityStatus.TEMPERATURE
