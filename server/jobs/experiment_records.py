"""What planning and driving a proposed experiment leave behind: units in the names, they go out over REST."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ExperimentPlan:
    """What `experiment` with this hash would drive. Nothing has moved.

    `size_frac`, `slower`: against the proposal, to keep the limits; `clearance_mm` is None without a known wall.
    """

    diagnosis_id: str
    plan_hash: str
    expires_in_s: float
    what: str
    separates: tuple[str, ...]
    duration_s: float
    size_frac: float
    slower: float
    tcp_speed_max_mm_s: float
    clearance_mm: float | None
    joint_travel_deg: tuple[float, ...]
    looks: int
    caution: str


@dataclass(frozen=True, slots=True)
class ExperimentDriven:
    """What was driven. `followed_by`: the diagnosis of the earlier recordings and this one together."""

    diagnosis_id: str
    plan_hash: str
    what: str
    segment: str
    duration_s: float
    looks_good: int
    followed_by: str = ""
    not_followed: str = ""
