"""Which runs make the evidence, and what each has to hold."""

from collections.abc import Iterator

from benchmarks.vision.odometry.film import FilmCase
from benchmarks.vision.odometry.run import Run

DISTANCES_M = (0.7, 1.0, 1.4, 2.0)
MAX_MM, END_MM, SCALE_FRAC, WRONG_SIGMA = 2.5, 1.0, 0.004, 3.0


def plain_runs(n: int, seed: int, rate_hz: float) -> Iterator[Run]:
    """Both shapes at all distances for n seeds."""
    for number in range(seed, seed + n):
        for shape in ("circle", "paper"):
            for distance_m in DISTANCES_M:
                yield Run(FilmCase(shape, distance_m, number, rate_hz))


def disturbed_runs(seed: int, rate_hz: float) -> Iterator[Run]:
    """One seed's disturbed runs: the readout not told, pairs dropped, blackout, hand; bias; faded texture."""
    for distance_m in DISTANCES_M:
        film = FilmCase("circle", distance_m, seed, rate_hz)
        yield Run(film, readout_known=False)
        yield Run(film, "every 4th")
        yield Run(film, "blackout")
        yield Run(film, "hand")
    for distance_m in DISTANCES_M:
        yield Run(FilmCase("circle", distance_m, seed, rate_hz, disparity_bias_px=0.1))
        yield Run(FilmCase("circle", distance_m, seed, rate_hz, contrast_frac=0.2))


def kept(case: dict) -> bool:
    """Whether a run's figures are inside what was asked for."""
    figures, film = case["figures"], case["film"]
    if film["disparity_bias_px"]:
        return abs(figures["scale_frac"]) <= SCALE_FRAC
    if film["contrast_frac"] is not None:
        return figures["worst_sigma"] <= WRONG_SIGMA  # of pairs that are called OK
    return figures["max_mm"] <= MAX_MM and figures["end_mm"] <= END_MM
