"""A recording of one drawn machine in the fast world: a tour of postures, looks at the wall's markers in each."""

from dataclasses import dataclass

import numpy as np

from benchmarks.reproduce.fast_camera import biased
from benchmarks.reproduce.fast_machine import QuasiStaticMachine
from benchmarks.reproduce.noise_model import NoiseModel
from benchmarks.reproduce.true_corners import EYES, TrueView
from machine.chain import chain_of
from machine.inverse import inverse_nearest
from machine.kinematics import tcp_pose
from machine.poses import pose
from machine.rotations import Array, rotation_from_rotvec
from recording.content import Recording
from recording.rows import MarkerCorners, PlcState, Row
from recording.run import RunInfo, Segment
from server.motion.lost_motion import first_stall
from server.motion.point_to_point import plan_joint_move
from sim_plc.world import World, rng_for

PAIRS = 20  # averaged in a look, as the server does
REACH_M, DEPTH_M, TURN_RAD = 0.30, 0.40, float(np.deg2rad(14.0))
TRIES = 400
NAN = float("nan")
LOOK_AGAIN_S = 3.5
Generator = np.random.Generator


@dataclass(frozen=True)
class Stop:
    """Encoders wanted at a stop (n,), and from which side each joint comes there (n,): +1 from below."""

    q: Array
    side: Array


def stops(world: World, count: int, rng: Generator) -> list[Stop]:
    """Postures around the start from which the wall's markers should be in view, by the nominal machine.

    The tool is moved and turned about where it starts; half the joints come from below, half from above, by chance.
    """
    chain, q_start = chain_of(world.nominal), np.asarray(world.q_start_rad, dtype=float)
    T_start = tcp_pose(chain, q_start)
    found: list[Stop] = []
    for _ in range(TRIES):
        if len(found) == count:
            break
        shift = np.array([rng.uniform(-REACH_M, REACH_M), rng.uniform(-REACH_M, REACH_M), rng.uniform(0.0, DEPTH_M)])
        R = rotation_from_rotvec(rng.uniform(-TURN_RAD, TURN_RAD, 3))
        T = pose(T_start[:3, :3] @ R, T_start[:3, 3] + T_start[:3, :3] @ shift)
        q = inverse_nearest(chain, T, q_start).q_rad
        if q is not None:
            found.append(Stop(q, rng.choice([-1.0, 1.0], len(q))))
    return found


def toured(world: World, noise: NoiseModel, machine_text: str, count: int, number: int) -> Recording:
    """The machine drives to each stop, rests, looks; the first third of the stops twice, for the noise floor.

    Args: number: which recording of this machine; each has postures and noise of its own.
    """
    rng = rng_for(world.seed, f"compensation tour {number}")
    machine, view = QuasiStaticMachine(world), TrueView(world)
    wanted = stops(world, count, rng)
    rows: list[Row] = []
    for stop in [*wanted, *wanted[: count // 3]]:
        if _drive(world, machine, stop):
            rows += _looks(machine, view, noise, rng)
    trace = machine.trace(0.0)
    for k in range(0, len(trace.t_s), 5):
        rows.append(_plc(float(trace.t_s[k]), trace.q_encoder[k]))
    end = float(trace.t_s[-1])
    run = RunInfo(
        f"tour {number}", "2026-01-01T00:00:00Z", None, 0.0, 0.0, None, (Segment("tour", "static", 0.0, end),)
    )
    return Recording("folder", run, machine_text, tuple(rows))


def _drive(world: World, machine: QuasiStaticMachine, stop: Stop) -> bool:
    """Come to a stop from the wanted sides; False where a leg is not possible."""
    stall = first_stall(world.nominal)
    below = np.deg2rad(0.8)
    for target in (stop.q - stop.side * (below + stall), stop.q + stop.side * stall):
        plan = plan_joint_move(world.nominal, machine.q_ref, target)
        if plan.trajectory is None:
            return False
        machine.play(plan.trajectory)
        machine.settle()
    return True


def _looks(machine: QuasiStaticMachine, view: TrueView, noise: NoiseModel, rng: Generator) -> list[Row]:
    """One look's mean corners of the wall's markers, both eyes, and one more some seconds later."""
    rows: list[Row] = []
    own = noise.stereo.ooi
    for _ in range(2):
        t_s = machine.t_s
        for marker in view.corners(machine.T_base_tcp()):
            if marker.on != "ooi":
                continue
            for eye in EYES:
                exact = marker.left_px if eye == "left" else marker.right_px
                if exact is not None:
                    sd = float(np.hypot(own.look_px, own.frame_px / np.sqrt(PAIRS)))
                    pixels = biased(exact, own) + rng.normal(0.0, sd, (4, 2))
                    (u0, v0), (u1, v1), (u2, v2), (u3, v3) = pixels.tolist()
                    rows.append(MarkerCorners(t_s, eye, marker.marker_id, u0, v0, u1, v1, u2, v2, u3, v3))
        until = machine.t_s + LOOK_AGAIN_S
        while machine.t_s < until:
            machine.settle()
    return rows


def _plc(t_s: float, q: Array) -> PlcState:
    none: tuple[float, ...] = ()
    return PlcState(t_s, -1, none, none, tuple(q.tolist()), none, none, none, NAN, NAN)
