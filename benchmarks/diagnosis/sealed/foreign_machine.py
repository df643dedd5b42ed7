"""The nominal machine of the foreign plant as a machine file states it: slew, lift and tilt of the PATU 655."""

from functools import cache

import numpy as np

from benchmarks.diagnosis.sealed import foreign_geometry as g
from benchmarks.diagnosis.sealed import foreign_numbers as k
from benchmarks.diagnosis.sealed import nominal_own as own
from machine.description import Joint
from machine.rotations import Array

NAMES = ("slew", "lift", "tilt")
POINTS = {"elbow": (2, (-0.30, 0.15, 0.06)), "tip": (3, (0.12, 0.0, 2.20)), "side": (3, (-0.06, 0.35, 1.30))}
LENGTHS = ((g.A1, g.D1, 90.0, 0.0), (g.A2, 0.0, 0.0, 0.0), (g.A3, 0.0, 90.0, 90.0))  # a, d, alpha, theta offset


@cache
def bodies() -> tuple[tuple[float, Array], ...]:
    """Mass and centre of mass in the DH frame of each link, the linkage as it lies at home."""
    tree = g.tree_bodies()
    pillar = g.together(tree[0], tree[1])
    R = g.turn(g.bracket_angle(float(k.HOME_RAD[2])))
    bracket = g.Body(tree[6].mass, R @ tree[6].com + g.on_lift(k.BRACKET_PIVOT), tree[6].inertia)
    lift, tilt = g.together(tree[2], tree[3], bracket), g.together(tree[4], tree[5])
    x, y, z = pillar.com - np.array([g.A1, 0.0, g.D1])
    return (
        (pillar.mass, np.array([x, z, -y])),
        (lift.mass, lift.com - np.array([g.A2, 0.0, 0.0])),
        (tilt.mass, g.in_link3(tuple(tilt.com))),
    )


@cache
def joints() -> tuple[Joint, ...]:
    """The three joints."""
    rad, out = np.deg2rad, []
    for j, (name, (a, d, alpha, offset), (mass, com)) in enumerate(zip(NAMES, LENGTHS, bodies(), strict=True)):
        low, high = k.RANGES_DEG[j]
        out.append(
            Joint(
                name, a, d, float(rad(alpha)), float(rad(offset)), float(rad(low)), float(rad(high)),
                float(rad(k.QD_MAX_DEG[j])), float(rad(k.QDD_MAX_DEG[j])), k.SPEED_FULL[j], k.VALVE_HZ,
                k.VALVE_DAMPING, k.KP[j], k.PT1_S[j], mass, (float(com[0]), float(com[1]), float(com[2])), k.COUNTS,
            )
        )  # fmt: skip
    return tuple(out)


@cache
def T_flange_tcp() -> Array:
    """The tool head at the boom's end: level at home, x_tcp up, -z_tcp ahead (where the camera looks)."""
    down = -float(k.HOME_RAD[1] + k.HOME_RAD[2])  # of the boom at home, below the horizon
    c, s = np.cos(down), np.sin(down)
    up, left, ahead = np.array([c, 0.0, -s]), np.array([0.0, -1.0, 0.0]), np.array([s, 0.0, c])
    T = np.eye(4)
    T[:3, :3] = np.stack([up, left, -ahead], axis=1)
    T[2, 3] = k.BOOM_END
    return T


def toml() -> str:
    """machine.toml."""
    return own.text_of("PATU 655", joints(), bodies(), T_flange_tcp(), POINTS)
