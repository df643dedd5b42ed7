"""The cell in virtual time: answers every request of the server's own plans, as the performer does on the real cell."""

from collections.abc import Generator
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from benchmarks.reproduce.fast_camera import FastCamera, Source
from benchmarks.reproduce.fast_lens import bent_path, lens_affine
from benchmarks.reproduce.fast_machine import Trace, TrueMachine
from benchmarks.reproduce.fast_odometry import odometry_path
from benchmarks.reproduce.noise_model import NoiseModel
from benchmarks.reproduce.watching import watch
from machine.chain import chain_of
from machine.kinematics import tcp_poses
from machine.rotations import Array
from server.calibration.contracts import CameraTrack, EncoderTrack
from server.calibration.kinematic_errors import usual_play
from server.calibration.play import PlayFollower
from server.jobs.context import Method, PlanContext
from server.jobs.knowledge import Knowledge
from server.jobs.requests import (
    Arm,
    MachineReading,
    Move,
    PairTiming,
    Progress,
    ReadMachine,
    Record,
    Request,
    SeenPairs,
    Settle,
    StartOdometry,
    StartWatching,
    StopOdometry,
    StopWatching,
    TakeLook,
    TimePairs,
)
from server.settings import ServerSettings
from server.vision.contracts import Look
from sim_plc.world import World, rng_for

Result = TypeVar("Result")


class FastWorldError(RuntimeError):
    """A plan asked for something the fast world cannot do."""


@dataclass(slots=True)
class FastCell:
    """One drawn machine with its camera. `true_looks`: true tool poses, `looks`: what was seen, by PLC time [ns].

    `late_s`: how much later than true the camera's exposures are taken to be (its latency, once the clocks are mapped).
    """

    world: World
    machine: TrueMachine
    camera: FastCamera
    noise: NoiseModel
    rng: np.random.Generator
    late_s: float
    spread_max_mm: float = 1.0
    true_looks: dict[int, Array] = field(default_factory=dict)
    looks: dict[int, Look] = field(default_factory=dict)
    _odometry_from_s: float = 0.0
    _watching_from_s: float = 0.0
    _watching: Source = "mono"
    _play: PlayFollower = field(init=False)
    _followed_to_s: float = 0.0

    def __post_init__(self) -> None:
        self._play = PlayFollower(usual_play(len(self.world.nominal.joints)))
        self._play.take_encoders(self.machine.t_s, self.machine.q_encoder)
        self._followed_to_s = self.machine.t_s

    @property
    def clock_ns(self) -> int:
        """Virtual time [ns]."""
        return round(1e9 * self.machine.t_s)

    def perform(self, request: Request) -> object:
        """The reply to one request.

        Raises: FastWorldError: a request that no plan of the server makes.
        """
        match request:
            case ReadMachine():
                return self._reading()
            case Settle():
                self.machine.settle()
                return self._reading()
            case Move():
                return self._move(request)
            case TakeLook():
                return self._look(request)
            case StartOdometry():
                self._odometry_from_s = self.machine.t_s
                return None
            case TimePairs():
                return PairTiming(1.0 / self.noise.odometry.rate_hz)
            case StopOdometry():
                return self.tracks(self._odometry_from_s)
            case StartWatching():
                self._watching_from_s, self._watching = self.machine.t_s, request.source
                return None
            case StopWatching():
                return self._watched()
            case Arm() | Progress() | Record():
                return None
        raise FastWorldError(f"no way to perform {type(request).__name__}")

    def _reading(self) -> MachineReading:
        t_ns = self.clock_ns
        return MachineReading(self.machine.q_encoder, self.machine.q_ref, t_ns, t_ns, side=self._side())

    def _side(self) -> Array:
        """Where the joints rest in their play, as the encoders told it since the last time."""
        trace = self.machine.trace(np.nextafter(self._followed_to_s, np.inf))
        for t_s, q in zip(trace.t_s, trace.q_encoder, strict=True):
            self._play.take_encoders(t_s, q)
        self._followed_to_s = self.machine.t_s
        return self._play.side_in_play

    def _move(self, request: Move) -> None:
        away = float(np.abs(request.trajectory.q[0] - self.machine.q_ref).max())
        if away > 1e-4:  # as the performer: a count is taken out, more is refused
            raise FastWorldError(f"{request.purpose}: trajectory starts {away:.1e} rad off the reference")
        self.machine.play(request.trajectory)

    def _look(self, request: TakeLook) -> Look:
        T_base_tcp = self.machine.T_base_tcp()
        self.true_looks[self.clock_ns] = T_base_tcp
        look = self.camera.look(T_base_tcp, request.n_pairs, request.source, self.spread_max_mm)
        self.looks[self.clock_ns] = look
        return look

    def _watched(self) -> tuple[SeenPairs, EncoderTrack]:
        trace = self.machine.trace(self._watching_from_s)
        sighted = watch(self.camera, trace, self._watching, self.late_s)
        return sighted, self._encoder_track(trace)

    def _encoder_track(self, trace: Trace) -> EncoderTrack:
        Ts_base_tcp = tcp_poses(chain_of(self.world.nominal), trace.q_encoder)
        return EncoderTrack(t_s=trace.t_s, Ts_base_tcp=Ts_base_tcp, qs=trace.q_encoder)

    def tracks(self, t_from_s: float) -> tuple[CameraTrack, EncoderTrack]:
        """Odometry and encoders since a time, the camera's stamps late by `late_s`."""
        trace = self.machine.trace(t_from_s)
        encoder = self._encoder_track(trace)
        period_s = 1.0 / self.noise.odometry.rate_hz
        picks = np.searchsorted(trace.t_s, np.arange(trace.t_s[0], trace.t_s[-1], period_s))
        Ts_base_cam = trace.Ts_base_tcp[picks] @ self.world.camera.T_tcp_cam_left
        bent = bent_path(Ts_base_cam, lens_affine(self.world, trace.Ts_base_tcp[0]))
        camera = CameraTrack(trace.t_s[picks] + self.late_s, odometry_path(bent, self.noise.odometry, self.rng))
        return camera, encoder


def fast_cell(world: World, machine: TrueMachine, noise: NoiseModel, late_s: float | None = None) -> FastCell:
    """A cell of a world; `late_s` None: its camera's latency."""
    rng = rng_for(world.seed, "fast world")
    camera = FastCamera(world, noise, rng)
    return FastCell(world, machine, camera, noise, rng, world.camera.latency_s if late_s is None else late_s)


def context_of(world: World, method: Method, settings: ServerSettings | None = None) -> PlanContext:
    """What the server's plans are given: the nominal machine and nothing of the truth."""
    machine = world.nominal
    return PlanContext(machine, chain_of(machine), settings or ServerSettings(), Knowledge(), method)


def run_plan(plan: Generator[Request, object, Result], cell: FastCell) -> Result:
    """Drive a plan to its result; its own errors pass through."""
    reply: object = None
    while True:
        try:
            request = plan.send(reply)
        except StopIteration as end:
            return end.value
        reply = cell.perform(request)
