"""How far the tool stays from the wall along a path."""

import numpy as np

from machine.chain import Chain
from machine.kinematics import tcp_jacobian
from server.motion.contracts import Array, PlanStatus, Wall
from server.motion.refusal import Refusal


def clearances(Ts_base_tcp: Array, T_tcp_tool: Array, wall: Wall) -> Array:
    """Distance to the wall of whichever is nearer, tool tip (tcp origin) or tool marker.

    Args:    Ts_base_tcp: (m, 4, 4); T_tcp_tool: (4, 4); wall: plane with its normal towards the machine.
    Returns: (m,) [m], negative behind the wall.
    """
    normal = _wall_unit_normal(wall)
    tips = Ts_base_tcp[:, :3, 3]
    markers = tips + Ts_base_tcp[:, :3, :3] @ T_tcp_tool[:3, 3]
    return np.minimum((tips - wall.point_base) @ normal, (markers - wall.point_base) @ normal)


def stall_reach(chain: Chain, qs: Array, stall_rad: Array, wall: Wall) -> Array:
    """How much nearer to the wall the tool may be (m,) [m] where joints rest up to a stall (n,) away from qs (m, n)."""
    normal = _wall_unit_normal(wall)
    return np.array([np.abs(normal @ tcp_jacobian(chain, q)[:3]) @ np.abs(stall_rad) for q in qs])


def wall_refusal(
    Ts_base_tcp: Array, T_tcp_tool: Array, wall: Wall | None, nearer_m: Array | float = 0.0
) -> tuple[float, Refusal | None]:
    """Smallest clearance [m] along a path, and the refusal when it is too small and smaller than where the path starts.

    A path that starts too near may lead away, never nearer. `nearer_m`: by how much the tool may be nearer than the
    path says, (m,) or one number.
    """
    if wall is None:
        return float("inf"), None
    distance = clearances(Ts_base_tcp, T_tcp_tool, wall) - nearer_m
    smallest = float(distance.min())
    if smallest >= min(wall.clearance_min_m, float(distance[0]) - 1e-4) - 1e-9:
        return smallest, None
    reason = (
        f"tool comes to {1e3 * smallest:.0f} mm from the wall, limit {1e3 * wall.clearance_min_m:.0f} mm; "
        "choose a larger stand-off, or look again if the wall is elsewhere"
    )
    return smallest, Refusal(PlanStatus.WALL, reason)


def _wall_unit_normal(wall: Wall) -> Array:
    """Of length one (3,)."""
    return np.asarray(wall.normal_base) / np.linalg.norm(wall.normal_base)
