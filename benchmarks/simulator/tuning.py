"""Finds the controllers' gains on the fine plant: the highest stable one over many postures and machines, halved."""

from dataclasses import dataclass

import numpy as np

from benchmarks.simulator.closed_loop import Gains, run_closed_loop
from machine.chain import chain_of
from machine.description import Machine
from machine.kinematics import tcp_pose
from machine.rotations import Array
from sim_plc.draw_plant import draw_plant
from sim_plc.draw_scene import draw_posture
from sim_plc.draw_world import posture_fault
from sim_plc.plant.plant import Plant
from sim_plc.plant.truth import PlantTruth
from sim_plc.world import rng_for

GAIN_MARGIN = 2.0  # 6 dB
SPEEDS_RAD_S = np.deg2rad([-2.0, 3.0, 6.0])  # slow: least oil damping; fast: most flow gain
RAMP_S, HOLD_S = 4.0, 3.0
FLOOR_RAD = np.deg2rad(0.06)  # peak to peak; smaller ones die away or are stick-slip, the same at any gain
KP_GRID = np.array([1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 24.0])


@dataclass(frozen=True, slots=True)
class Case:
    """One machine in one posture."""

    truth: PlantTruth
    q_start: Array
    reach_m: float


def posture_box(machine: Machine, preset: str, n: int, seed: int = 0) -> tuple[Case, ...]:
    """n machines (seeds 0..n-1), their reaches spread evenly over 2.5 to 4.3 m."""
    rng, chain = rng_for(seed, "tuning"), chain_of(machine)
    edges = np.linspace(2.5, 4.3, n + 1)
    cases: list[Case] = []
    while len(cases) < n:
        q_start = draw_posture(machine, preset, rng)
        if q_start is None or posture_fault(machine, q_start) is not None:
            continue
        p = tcp_pose(chain, q_start)[:3, 3]
        reach = float(np.hypot(p[0], p[1]))
        if edges[len(cases)] <= reach <= edges[len(cases) + 1]:
            cases.append(Case(draw_plant(machine, preset, len(cases)), q_start, reach))
    return tuple(cases)


def oscillation(signal: Array) -> float:
    """Peak to peak of a window (n,) about its own parabola, in the signal's unit."""
    x = np.linspace(-1.0, 1.0, len(signal))
    return float(np.ptp(signal - np.polynomial.polynomial.polyval(x, np.polynomial.polynomial.polyfit(x, signal, 2))))


def is_stable(machine: Machine, case: Case, gains: Gains, joint: int, speed: float) -> bool:
    """Whether the joint's encoder calms down on a ramp and stays quiet at the end of the hold after it."""
    t = np.arange(round((RAMP_S + HOLD_S) * 1e3)) * 1e-3
    q_ref = np.repeat(case.q_start[None], len(t), axis=0)
    limits = machine.joints[joint].q_min_rad, machine.joints[joint].q_max_rad
    middle = 0.5 * (limits[0] + limits[1])
    speed = speed if (middle - case.q_start[joint]) * speed > 0.0 else -speed  # away from the end stops
    q_ref[:, joint] += speed * np.minimum(t, RAMP_S)
    q = run_closed_loop(Plant(case.truth, case.q_start), gains, q_ref).q[:, joint]
    early, late = oscillation(q[1000:2000]), oscillation(q[3000:4000])
    return late < max(FLOOR_RAD, 0.9 * early) and oscillation(q[-1000:]) < FLOOR_RAD


def stability_limit(machine: Machine, cases: tuple[Case, ...], gains: Gains, joint: int) -> float:
    """Highest gain of KP_GRID with which one joint stays stable in every case, the others at `gains`; 0 if none.

    Searched downwards: at very low gains the loop is slow and sticks, which is no instability.
    """
    for kp in KP_GRID[::-1]:
        changed = gains.kp.copy()
        changed[joint] = kp
        trial = Gains(changed, gains.tau)
        if all(is_stable(machine, case, trial, joint, speed) for case in cases for speed in SPEEDS_RAD_S):
            return float(kp)
    return 0.0


def tuned_gains(machine: Machine, cases: tuple[Case, ...], tau: Array, kp_max: Array) -> tuple[Gains, Array]:
    """Gains with at least 6 dB margin, and the stability limits (6,) they come from.

    Model:   kp_j = min(limit_j / 2, kp_max_j); starts at the machine file's gains, one round.
    """
    kp = np.array([joint.kp_frac_per_rad for joint in machine.joints])
    limits = np.zeros(6)
    for joint in range(6):
        limits[joint] = stability_limit(machine, cases, Gains(kp, tau), joint)
        kp[joint] = min(limits[joint] / GAIN_MARGIN, kp_max[joint])
    return Gains(kp, tau), limits
