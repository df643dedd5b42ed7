"""What planning and driving an identification leave behind: units in the names, they go out over REST."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class IdentificationPart:
    """One part of the drive. `shows`: what it is for; `cannot`: what it leaves open here, and why; empty: nothing."""

    name: str
    duration_s: float
    shows: tuple[str, ...]
    cannot: str = ""


@dataclass(frozen=True, slots=True)
class IdentificationPlan:
    """What `identify` with this hash would drive. Nothing has moved. `cannot`: of the drive as a whole."""

    plan_hash: str
    expires_in_s: float
    duration_s: float
    parts: tuple[IdentificationPart, ...]
    cannot: tuple[str, ...]
    looks: int
    tcp_speed_max_mm_s: float
    clearance_mm: float | None
    joint_travel_deg: tuple[float, ...]
    tcp_path_m: tuple[tuple[float, float, float], ...]
    caution: str


@dataclass(frozen=True, slots=True)
class IdentificationDriven:
    """What was driven. `left`: parts that are still to be driven; `followed_by`: the diagnosis of all recordings."""

    plan_hash: str
    parts: tuple[str, ...]
    left: tuple[str, ...]
    duration_s: float
    looks_good: int
    followed_by: str = ""
    not_followed: str = ""
