"""How long a plan that an operator has seen may be driven."""

from server.errors import PlanRefusedError


def require_fresh(plan_hash: str, t_made_ns: int, expires_ns: int, t_now_ns: int, remedy: str) -> None:
    """Raises: PlanRefusedError: the plan has expired, with its age, the limit and the remedy."""
    if t_now_ns > expires_ns:
        age_s, most_s = (t_now_ns - t_made_ns) * 1e-9, (expires_ns - t_made_ns) * 1e-9
        raise PlanRefusedError(
            f"plan {plan_hash} is {age_s:.0f} s old and has expired (limit {most_s:.0f} s, [position] plan_expires_s); "
            f"{remedy}"
        )
