"""The closed loop in virtual time: the real plan, the real PC end, the real PLC program and the fine plant.

The camera sees the true tool with a little noise, `latency_s` later; `hidden_from_s` takes the object of interest away.
"""

from dataclasses import dataclass, field

import numpy as np

from benchmarks.simulator.virtual import VirtualMachine
from machine.chain import chain_of
from machine.poses import inverse_pose, pose
from machine.rotations import rotation_from_rotvec
from protocol.client_events import TailAnswered, TrajectoryEnded
from protocol.codes import PlcState
from server.calibration.contracts import CalibrationStatus, CameraRotationEstimate
from server.errors import JobFailedError
from server.jobs.context import PlanContext
from server.jobs.knowledge import Knowledge
from server.jobs.requests import (
    Correct,
    EndMove,
    MachineReading,
    NextPair,
    PairSeen,
    ReadMachine,
    Settle,
    StartMove,
    StopMove,
    TakeLook,
)
from server.link.samples import knots_from, knots_of
from server.settings import ServerSettings, read_machine
from server.vision.contracts import Look, LookStatus, ObjectPose, PoseStatus
from sim_plc.draw_world import draw_world

MS = 1_000_000
NOISE = np.diag([1e-3] * 3 + [2e-4] * 3)


@dataclass
class Frame:
    """One exposure: its time [ns, PLC], the true pose then, and when its report arrives."""

    number: int
    t_exposure_ns: int
    t_arrival_ns: int
    T_base_tcp: np.ndarray
    q: np.ndarray
    hidden: bool


@dataclass
class VirtualCell:
    """Answers the plan's requests in virtual time; `told` are the requests, `frames` what the camera exposed."""

    preset: str = "realistic"
    seed: int = 1
    rate_hz: float = 60.0
    latency_s: float = 0.040
    hidden_from_s: float = float("inf")  # after the start of the motion
    silent_from_s: float = float("inf")
    in_motion: int = 1  # which of the motions it happens in: 1 to just before the goal, 2 in
    start_error_mm: tuple[float, float, float] = (6.0, -5.0, 40.0)
    gap_at_rest: tuple[int, int] = (0, 0)  # exposures that never come, counted from the first
    thinking_ms: int = 15  # what a plan's step costs while it plans a new tail
    told: list = field(default_factory=list)  # type: ignore[type-arg]
    frames: list[Frame] = field(default_factory=list)
    states: list[tuple[int, PlcState]] = field(default_factory=list)
    events: list = field(default_factory=list)  # type: ignore[type-arg]

    def __post_init__(self) -> None:
        self.machine = read_machine("hiab033")
        world = draw_world(self.machine, self.preset, self.seed)
        self.T_tcp_cam = world.camera.T_tcp_cam_left
        self.T_tcp_tool = world.scene.T_tcp_tool
        self.virtual = VirtualMachine(world)
        self.virtual.arm()
        self.virtual.step(500)
        start = pose(rotation_from_rotvec(np.deg2rad([0.3, -0.2, 0.4])), np.array(self.start_error_mm) * 1e-3)
        start[2, 3] += 0.1
        self.T_base_ooi = self.true_tool() @ inverse_pose(start)
        self.rng = np.random.default_rng(self.seed)
        self.t_motion_ns: int | None = None
        self.motions = self.exposures = 0
        self.traj_id, self.tail = 100, "none"
        self.next_frame_ns = self.t_ns
        self.tail_text, self.t_arrival_ns = "", self.t_ns

    @property
    def t_ns(self) -> int:
        return self.virtual.machine.t_plc_ns

    def true_tool(self) -> np.ndarray:
        return self.virtual.machine.plant.T_base_tcp() @ self.T_tcp_tool

    def error_mm(self) -> np.ndarray:
        T = inverse_pose(self.T_base_ooi) @ self.true_tool()
        return 1e3 * (T[:3, 3] - [0.0, 0.0, 0.1])

    def context(self, **changed) -> PlanContext:
        """What the plan is given: the nominal machine and a mount known to a degree."""
        settings = {"position": {"closed_loop": True}, "closed_loop": {"silence_max_ms": 100.0, **changed}}
        R = rotation_from_rotvec(np.deg2rad([0.6, -0.5, 0.4])) @ self.T_tcp_cam[:3, :3]
        known = Knowledge()
        known.mount_rotation_estimate = CameraRotationEstimate(
            CalibrationStatus.OK, "", "test", R, np.eye(3) * 1e-4, -self.latency_s, 0.5, 1.0, 50, 0.2, 1.0
        )
        return PlanContext(self.machine, chain_of(self.machine), ServerSettings.model_validate(settings), known)

    def step(self, ms: int) -> None:
        for _ in range(ms):
            self.virtual.step(1)
            state = self.virtual.machine.plc.state
            if not self.states or self.states[-1][1] is not state:
                self.states.append((self.t_ns, state))
            if self.t_ns >= self.next_frame_ns:
                self._expose()
            for event in self.virtual._events:
                self._heard(event)
            self.virtual._events.clear()

    def _expose(self) -> None:
        self.next_frame_ns += round(1e9 / self.rate_hz)
        self.exposures += 1
        if self.gap_at_rest[0] <= self.exposures < self.gap_at_rest[1]:
            return
        there = self.t_motion_ns is not None and self.motions == self.in_motion
        since_s = (self.t_ns - self.t_motion_ns) * 1e-9 if there and self.t_motion_ns is not None else -1.0
        if since_s >= self.silent_from_s:
            return
        hidden = since_s >= self.hidden_from_s
        plant = self.virtual.machine.plant
        arrival = self.t_ns + round(1e9 * self.latency_s)
        self.frames.append(
            Frame(len(self.frames) + 1, self.t_ns, arrival, plant.T_base_tcp(), plant.q_encoder_rad.copy(), hidden)
        )

    def _heard(self, event: object) -> None:
        self.events.append((self.t_ns, event))
        if isinstance(event, TailAnswered):
            self.tail, self.tail_text = ("taken" if event.taken else "refused"), event.text
        if isinstance(event, TrajectoryEnded):
            self.ended = event

    def perform(self, request: object) -> object:
        self.told.append((self.t_ns, request))
        match request:
            case ReadMachine() | Settle():
                self.step(1500 if isinstance(request, Settle) else 20)
                return self._reading()
            case TakeLook():
                return self._look()
            case StartMove():
                return self._start(request)
            case NextPair():
                return self._next(request)
            case Correct():
                return self._correct(request)
            case EndMove():
                return self._end()
            case StopMove():
                return self._stop(request)
        return None

    def _reading(self) -> MachineReading:
        plant, plc = self.virtual.machine.plant, self.virtual.machine.plc
        return MachineReading(plant.q_encoder_rad.copy(), plc.reference.q.copy(), self.t_ns, self.t_ns)

    def _poses(self, T_base_tcp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        T_cam_base = inverse_pose(T_base_tcp @ self.T_tcp_cam)
        tool, ooi = T_cam_base @ T_base_tcp @ self.T_tcp_tool, T_cam_base @ self.T_base_ooi
        return self._noisy(tool), self._noisy(ooi)

    def _noisy(self, T: np.ndarray) -> np.ndarray:
        noise = NOISE @ self.rng.standard_normal(6)
        return pose(rotation_from_rotvec(noise[:3]) @ T[:3, :3], T[:3, 3] + noise[3:])

    def _look(self) -> Look:
        tool, ooi = self._poses(self.virtual.machine.plant.T_base_tcp())
        C = NOISE**2 / 20.0
        return Look(LookStatus.OK, "", tool, ooi, C, C, 20, 20, 0, 0, 0.1)

    def _start(self, request: StartMove) -> None:
        self.traj_id += 1
        self.ended, self.tail = None, "none"
        knots = knots_from(knots_of(request.trajectory, 6))
        refusals = self.virtual.client.request_run(self.traj_id, knots, self.t_ns)
        assert refusals == (), refusals
        self.t_motion_ns = self.t_ns
        self.motions += 1

    def _next(self, request: NextPair) -> PairSeen:
        while True:
            arrived = [frame for frame in self.frames[-20:] if frame.t_arrival_ns <= self.t_ns]
            if arrived and arrived[-1].number > request.after_number:
                self.t_arrival_ns = arrived[-1].t_arrival_ns
                return self._seen(arrived[-1], "")
            if self.t_ns - self.t_arrival_ns > request.silence_max_s * 1e9:
                return self._seen(request.after_number, f"no pair for {1e3 * request.silence_max_s:.0f} ms")
            self.step(1)

    def _seen(self, frame: Frame | int, fault: str) -> PairSeen:
        tail, self.tail = self.tail, ("none" if self.tail in ("taken", "refused") else self.tail)
        state = self.virtual.client.state
        playing = state is not None and state.plc_state is PlcState.RUN
        t_play_s = (state.t_play_ns + self.virtual.client.age_ns(self.t_ns)) * 1e-9 if playing else 0.0
        ended = self.t_motion_ns is None or self.ended is not None
        if isinstance(frame, int):
            return PairSeen(frame, fault, None, None, None, t_play_s, ended, tail, self.tail_text)
        tool, ooi = self._poses(frame.T_base_tcp)
        lost = ObjectPose("ooi", PoseStatus.NOT_SEEN, "no marker in either eye", None, None, (), 0.0, 0.0)
        seen = [
            ObjectPose(name, PoseStatus.OK, "", T, NOISE**2, (), 0.1, 99.0)
            for name, T in (("tool", tool), ("ooi", ooi))
        ]
        found = lost if frame.hidden else seen[1]
        return PairSeen(frame.number, "", seen[0], found, frame.q, t_play_s, ended, tail, self.tail_text)

    def _correct(self, request: Correct) -> None:
        self.step(self.thinking_ms)
        knots = knots_from(knots_of(request.trajectory, 6))
        refusals = self.virtual.client.request_tail(self.traj_id, request.first_knot, knots, self.t_ns)
        self.tail, self.tail_text = ("refused", refusals[0].as_line) if refusals else ("pending", "")

    def _end(self) -> None:
        while self.ended is None:
            self.step(1)
        self.t_motion_ns = None
        if not self.ended.reached:
            raise JobFailedError(self.ended.reason, "motion_ended_early")

    def _stop(self, request: StopMove) -> None:
        self.virtual.client.request_stop(request.reason)
        while self.virtual.machine.plc.state is not PlcState.HOLD:
            self.step(1)

    @property
    def t_stop_ns(self) -> int:
        """PLC time at which the ramp began."""
        return next(t for t, state in self.states if state is PlcState.STOPPING)


def drive(plan, cell: VirtualCell):  # type: ignore[no-untyped-def]
    """Drive a plan to its result."""
    reply = None
    while True:
        try:
            request = plan.send(reply)
        except StopIteration as end:
            return end.value
        reply = cell.perform(request)
