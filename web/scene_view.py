"""Contents of the 3D scene at one instant: frozen data that cross a process boundary."""

from dataclasses import dataclass

from machine.rotations import Array


@dataclass(frozen=True, slots=True)
class PlanShown:
    """The previewed plan: joints along it (m, n) [rad], the tool's way (m, 3) [m, base], and what it will leave.

    `ellipsoid_radii_m` (3,): two sigma of the predicted error along the axes of `T_base_ellipsoid`.
    """

    name: str
    qs_rad: Array
    path_base_m: Array
    T_base_ellipsoid: Array
    ellipsoid_radii_m: Array


@dataclass(frozen=True, slots=True)
class SceneView:
    """Joints [rad], the machine's tool and camera, the target if known, the previewed plan if any.

    `scrub_frac` 0..1 along the plan; `track_base_m` (k, 3): where odometry
    saw the camera go; `map_base_m` (p, 3): the points that it went by; `picture_jpeg`: thumbnail for the frustum, None:
    as before.
    """

    q_rad: tuple[float, ...]
    T_base_cam: Array
    T_base_tool: Array
    T_base_ooi: Array | None
    plan: PlanShown | None
    scrub_frac: float
    track_base_m: Array | None
    map_base_m: Array | None
    picture_jpeg: bytes | None
