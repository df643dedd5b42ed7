"""One case: made, diagnosed without its truth, and compared with it."""

from dataclasses import asdict, dataclass

from benchmarks.diagnosis.answered import answered
from benchmarks.diagnosis.links.cases import draw
from benchmarks.diagnosis.links.recorded import over

SIZES = ("gain_frac", "time_constant_s", "half_width_frac", "delay_s")


@dataclass(frozen=True)
class Outcome:
    """What was true and what was told. `sizes_held`, `sizes_told`: of the right names, those within their limits."""

    seed: int
    kind: str
    link: dict[str, float]
    true: list[list]
    told: list[list]
    verdict: str
    why: str
    sizes_held: int
    sizes_told: int

    @property
    def refused(self) -> bool:
        """Whether nothing was claimed."""
        return self.verdict in ("outside", "undecided")

    @property
    def exact(self) -> bool:
        """Whether all that is true was claimed, and nothing else."""
        claimed = [] if self.verdict == "none" else self.told
        return not self.refused and sorted(map(str, claimed)) == sorted(map(str, self.true))

    @property
    def false(self) -> bool:
        """Whether something was claimed that is not there."""
        return self.verdict == "effects" and any(one not in self.true for one in self.told)


def run_case(seed: int) -> Outcome:
    """The case of a seed, through to its answer."""
    case = draw(seed)
    found = answered(over(case.link, case.effects, seed))
    top = found["hypotheses"][0]["effects"] if found["hypotheses"] else []
    sizes = {(one.name, one.joint): dict(one.values) for one in case.effects}
    sizes["transport_delay", None] = {"delay_s": case.link.usual_delay_s}
    held = [
        told["low"] <= sizes[one["name"], one["joint"]][name] <= told["high"]
        for one in top
        for name, told in one["parameters"].items()
        if name in SIZES and (one["name"], one["joint"]) in case.true and (one["name"], one["joint"]) in sizes
    ]
    return Outcome(
        seed,
        case.kind,
        asdict(case.link),
        [list(key) for key in case.true],
        [[one["name"], one["joint"]] for one in top],
        found["verdict"],
        found["why"],
        sum(held),
        len(held),
    )
