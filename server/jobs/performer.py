"""The performer: how each request of a plan is carried out on link, camera and recorder."""

import asyncio
from collections import deque
from dataclasses import replace

import numpy as np

from machine.kinematics import tcp_poses
from recording.clock import mono_ns, mono_s
from server.calibration.contracts import Array, EncoderTrack
from server.calibration.kinematic_errors import usual_play
from server.calibration.play import PlayFollower
from server.camera.contracts import FrameReport
from server.errors import JobFailedError
from server.jobs.cell import Cell
from server.jobs.requests import (
    Arm,
    BeginSegment,
    Correct,
    EndMove,
    EndSegment,
    MachineReading,
    Move,
    NextPair,
    PairTiming,
    ReadMachine,
    Record,
    Request,
    Settle,
    StartMove,
    StartOdometry,
    StartWatching,
    Steer,
    StopMove,
    StopOdometry,
    StopWatching,
    TakeLook,
    TimePairs,
    UseTarget,
    sighted_of,
)
from server.jobs.steering import Steering
from server.link.contracts import LinkPhase, PlcSample, measured_oil_c
from server.link.samples import stood_still
from server.motion.contracts import JointTrajectory
from server.vision.contracts import OdometryStatus, PairObservation

READING_WINDOW_S = 0.1
PLC_SILENCE_MAX_S = 1.0  # a job gives up then; motion is stopped by link process and PLC, both after 250 ms
REST_WINDOW_S = 0.4
REST_SPEED_RAD_S = 2e-4  # 0.8 mm/s at 4 m
REST_LAG_RAD_S = 1e-4
SWITCH_PAIRS, SWITCH_POLL_S = 2, 0.02
WATCHED_PAIRS_MAX = 180 * 60  # pairs: as long as encoders are kept to join them with, at 60 a second
PAIRS_SEEN_S, TIMING_MAX_S = 0.05, 6.0  # at the slowest camera of use, one pair a second, it is six pairs
ARMING_SHIFT_MAX_RAD = 1e-4  # four counts of an 18-bit encoder: 0.4 mm at 4 m


class Performer:
    """Carries out requests; knows whether the machine may be moving on our behalf."""

    def __init__(self, cell: Cell) -> None:
        self._cell = cell
        self._odometry_from_ns = 0
        self._odometry_on = False
        self._steering = Steering(cell)
        self._watching_from_ns, self._watching_by = 0, "stereo"
        self._watched: deque[tuple[float, PairObservation]] | None = None
        self._play = PlayFollower(usual_play(cell.chain.n))
        cell.vision.on_report(self._watch)
        self.may_be_moving = False

    async def perform(self, request: Request) -> object:
        """Carry out one request and return its reply; expected failures raise ServerError or LinkError."""
        match request:
            case ReadMachine():
                return self._reading()
            case Arm():
                return await self._arm()
            case Move():
                return await self._move(request)
            case Settle():
                return await self._settle()
            case TakeLook():
                return await self._look(request)
            case StartOdometry():
                return await self._start_odometry()
            case TimePairs():
                return await self._time_pairs(request.n_pairs)
            case StopOdometry():
                return await self._stop_odometry()
            case StartWatching():
                return await self._start_watching(request)
            case StopWatching():
                return self._take_watched_pairs()
            case StartMove() | NextPair() | Correct() | EndMove() | StopMove():
                return await self._steer(request)
            case UseTarget():
                return await self._use_target(request)
            case BeginSegment():
                return self._cell.recorder.begin_segment(request.name, request.kind)
            case EndSegment():
                return self._cell.recorder.end_segment()
        raise TypeError(f"no way to perform {type(request).__name__}")

    async def _use_target(self, request: UseTarget) -> None:
        """Returns when pairs come that see the new target: one may still be processed for the former one."""
        since_ns, until_s = mono_ns(), mono_s() + PLC_SILENCE_MAX_S
        self._cell.vision.use_target(request.target)
        while len(self._cell.vision.reports_since(since_ns)) < SWITCH_PAIRS and mono_s() < until_s:  # noqa: ASYNC110 no event
            await asyncio.sleep(SWITCH_POLL_S)

    def record(self, request: Record) -> None:
        """Hand a finding to the recorder."""
        self._cell.recorder.record(request.item, request.text)

    def observe_plc_sample(self, sample: PlcSample) -> None:
        """Every PLC sample, also between jobs: every motion counts for where the joints rest in their play."""
        self._play.take_encoders(sample.t_plc_ns * 1e-9, np.array(sample.q_rad))

    async def hold_until(self, t_mono_ns: int | None) -> None:
        """Let motion go on until then only; None: it need not be held."""
        await self._cell.link.hold_until(t_mono_ns)

    async def stop_motion(self, reason: str) -> None:
        """Ramp down and hold."""
        try:
            await self._cell.link.stop(reason)
        finally:
            await self._steering.forget_motion()
        self.may_be_moving = False

    def release(self) -> None:
        """Switch off what a job left on: a plan that is cut short never comes to its own StopOdometry."""
        self._watched = None
        if self._odometry_on:
            self._odometry_on = False
            self._cell.vision.drop_odometry()

    def _fresh_samples(self, window_s: float) -> list[PlcSample]:
        now = mono_ns()
        samples = self._cell.link.samples_since(now - int(window_s * 1e9))
        latest = self._cell.link.latest
        if latest is None or now - latest.t_mono_ns > PLC_SILENCE_MAX_S * 1e9:
            age = "missing" if latest is None else f"{(now - latest.t_mono_ns) / 1e6:.0f} ms old"
            raise JobFailedError(
                f"PLC state is {age} (limit {PLC_SILENCE_MAX_S * 1e3:.0f} ms); check cable, PLC program and the plc "
                "settings",
                "plc_silent",
            )
        return samples or [latest]

    def _reading(self) -> MachineReading:
        samples = self._fresh_samples(READING_WINDOW_S)
        return MachineReading(
            q_rad=np.mean([sample.q_rad for sample in samples], axis=0),
            q_ref_rad=np.array(samples[-1].q_ref_rad),
            t_plc_ns=samples[-1].t_plc_ns,
            t_mono_ns=samples[-1].t_mono_ns,
            oil_temperature_c=measured_oil_c(samples[-1]),
            side=self._play.side_in_play,
        )

    async def _arm(self) -> None:
        if self._cell.link.health.dry_run:
            raise JobFailedError(
                "PLC is in dry run: its valves stay neutral and nothing would move; end the dry run at the PLC",
                "dry_run",
            )
        if self._cell.link.health.phase is not LinkPhase.ARMED:
            self._fresh_samples(READING_WINDOW_S)
            await self._cell.link.arm()

    async def _move(self, request: Move) -> None:
        self.may_be_moving = True
        trajectory = self._from_reference(request.trajectory)
        self._cell.recorder.begin_marks(request.segment_marks)
        try:
            ended = await self._cell.link.run(trajectory)
        finally:
            self._cell.recorder.end_marks()
        if not ended.reached:  # why it ended may be wrong or not the last word: a stop follows, until it is at rest
            raise JobFailedError(f"{request.purpose}: motion ended early: {ended.reason}", "motion_ended_early")
        self.may_be_moving = False

    async def _steer(self, request: Steer) -> object:
        match request:
            case StartMove():
                self.may_be_moving = True
                trajectory = self._from_reference(request.trajectory)
                await self._steering.start(trajectory)
            case NextPair():
                return await self._steering.next_pair(request)
            case Correct():
                self._steering.correct(request)
            case EndMove():
                await self._steering.wait_for_end()
                self.may_be_moving = False
            case StopMove():
                await self.stop_motion(request.reason)
        return None

    def _from_reference(self, trajectory: JointTrajectory) -> JointTrajectory:
        """The trajectory begun at the PLC's reference: arming sets that to the encoders, a count off the plan.

        More than a few counts is not ours to take out: the motion gate refuses it.
        """
        latest = self._cell.link.latest
        if latest is None:
            return trajectory
        away = np.array(latest.q_ref_rad) - trajectory.q[0]
        return replace(trajectory, q=trajectory.q + away) if np.abs(away).max() <= ARMING_SHIFT_MAX_RAD else trajectory

    async def _settle(self) -> MachineReading:
        timeout_s = self._cell.settings.position.settle_timeout_s
        deadline = mono_s() + timeout_s
        while mono_s() < deadline:
            samples = self._fresh_samples(REST_WINDOW_S)
            if stood_still(samples, REST_WINDOW_S, REST_SPEED_RAD_S, REST_LAG_RAD_S):
                return self._reading()
            await asyncio.sleep(0.05)
        raise JobFailedError(
            f"encoders did not come to rest within {timeout_s:.0f} s (limit {REST_SPEED_RAD_S:.0e} rad/s); "
            "look for a limit cycle or a leaking valve",
            "not_at_rest",
        )

    async def _look(self, request: TakeLook) -> object:
        await self._cell.vision.set_pose_source(request.source)
        look = self._cell.settings.look
        taken = await self._cell.vision.look(request.n_pairs, look.timeout_s, look.spread_max_mm)
        self._cell.recorder.record(taken)
        return taken

    async def _start_odometry(self) -> None:
        self._odometry_from_ns, self._odometry_on = mono_ns(), True
        await self._cell.vision.start_odometry()

    async def _time_pairs(self, pairs: int) -> PairTiming:
        """The longest but one: a single late pair is followed by optical flow."""
        began_ns = mono_ns()
        while True:
            await asyncio.sleep(PAIRS_SEEN_S)
            times_s = [
                report.t_exposure_mapped_ns * 1e-9
                for report in self._cell.vision.reports_since(began_ns)
                if report.odometry is not None and report.odometry.status is not OdometryStatus.LOST
            ]
            waited_s = (mono_ns() - began_ns) * 1e-9
            if len(times_s) >= pairs or waited_s > TIMING_MAX_S:
                intervals_s = np.sort(np.diff(times_s))
                return PairTiming(float(intervals_s[-2]) if len(intervals_s) > 1 else waited_s / max(1, len(times_s)))

    async def _stop_odometry(self) -> object:
        camera = await self._cell.vision.stop_odometry()
        self._odometry_on = False
        samples = self._cell.link.samples_since(self._odometry_from_ns - int(0.5e9))
        return camera, self._encoder_track(samples)

    async def _start_watching(self, request: StartWatching) -> None:
        await self._cell.vision.set_pose_source(request.source)
        self._watching_by = request.source
        self._watching_from_ns = mono_ns()
        self._watched = deque(maxlen=WATCHED_PAIRS_MAX)

    def _watch(self, report: FrameReport) -> None:
        if self._watched is not None and report.fit_for_look and report.pose_source == self._watching_by:
            self._watched.append((report.t_exposure_mapped_ns * 1e-9, report.observation))

    def _take_watched_pairs(self) -> object:
        watched, self._watched = self._watched or (), None
        samples = self._cell.link.samples_since(self._watching_from_ns - int(0.5e9))
        return sighted_of(watched), self._encoder_track(samples)

    def _encoder_track(self, samples: list[PlcSample]) -> EncoderTrack:
        offset_ns = self._cell.link.plc_to_pc_offset_ns or 0
        t_s = np.array([(sample.t_plc_ns + offset_ns) * 1e-9 for sample in samples])
        qs: Array = np.array([sample.q_rad for sample in samples])
        return EncoderTrack(t_s=t_s, Ts_base_tcp=tcp_poses(self._cell.chain, qs), qs=qs)
