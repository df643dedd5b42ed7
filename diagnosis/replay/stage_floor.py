"""The noise of a dynamic stage's increments: what repeats show, what a baseline leaves, the least that is believed."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.errors import DiagnosisError
from diagnosis.log.tables import fill_gaps
from diagnosis.noise.floor import (
    Floor,
    Whitener,
    block_increments,
    fit_whitener,
    floor_of_repeats,
    floor_without_repeats,
    repeat_deviations,
    with_remainder,
)
from diagnosis.replay.repeats import align_repeats
from diagnosis.replay.replayer import PreparedStretch, Replayer
from diagnosis.replay.stretches import Stretch, repeat_groups
from machine.effects.layout import ParameterSets
from machine.remainder import Remainder
from machine.rotations import Array

# Repeats between which the machine itself changed: a gain that drifts is not noise.
GAIN_CHI2_PER_REPEAT_MIN = 30.0  # chi2 for each repeat's own gain: five standard errors and more
GAIN_REPEATS_MIN = 3  # two repeats have one difference, which is noise as well as anything


def without_proportional_part(repeats: Array, motion: Array, dt_s: float, where: NDArray[np.bool_]) -> Array:
    """Residuals of repeats (R, m, n) without what each has in proportion to the motion, if that is significant.

    Model: d_r = g_r M + noise over white increments; chi2 = sum (g_r / its error)^2, by the noise that still holds it.
    Args:  motion: (R, m, n), what was measured of the same output. where: columns (n,) that are asked.
    """
    if len(repeats) < GAIN_REPEATS_MIN:
        return repeats
    out = repeats.copy()
    steps = [block_increments(repeat, dt_s) for repeat in repeat_deviations(repeats)]
    mean = block_increments(motion.mean(axis=0), dt_s)
    for j in np.nonzero(where)[0]:
        white = fit_whitener([step[:, [j]] for step in steps])
        moved = white.whiten(mean[:, [j]])[:, 0]
        power = float(moved @ moved)
        if power <= 0.0:
            continue
        gains = np.array([float(moved @ white.whiten(step[:, [j]])[:, 0]) for step in steps]) / power
        if float(gains @ gains) * power > GAIN_CHI2_PER_REPEAT_MIN * (len(repeats) - 1):
            course = motion[:, :, j].mean(axis=0)
            out[:, :, j] -= np.outer(
                (gains - gains.mean()) / np.sqrt(len(repeats) / (len(repeats) - 1.0)), course - course[0]
            )
    return out


# Of the least sigma: below it repeats are equal but for rounding, and their filter means nothing
WHITENING_SIGMA_MIN_FRAC = 0.2
CREDIBLE_SIGMA_MIN_BY_STAGE = {
    "link": 2e-5,
    "controller": 2e-4,
    "actuator": 2e-6,
}  # nothing smaller moves the tcp by 0.1 mm
# Of the least sigma, where a program leaves nothing day by day: no noise adds up along a move
NOISELESS_SIGMA_MIN_FRAC = 0.25
# Of an encoder's step, sqrt(2 / 12): two roundings, which repeats do not show when they round alike
ROUNDING_SIGMA_STEP_FRAC = 0.41


def stage_floor(replayer: Replayer, stage: str, prepared: list[PreparedStretch], base: ParameterSets) -> Floor:
    """The noise of a stage's residual, all joints: from the largest group of repeats, else a stand-in."""
    residuals = {entry.stretch.name: replayer.residuals(stage, entry, base) for entry in prepared}
    known = {name: np.nan_to_num(rows[0]) for name, rows in residuals.items() if rows is not None}
    groups = repeat_groups(tuple(entry.stretch for entry in prepared))
    members = max(groups.values(), key=len, default=())
    dt = prepared[0].stretch.dt_s
    floor: Floor | None = None
    steps: list[Array] = []
    records = [replayer.nominal_machine.baseline_remainder(stage, j + 1) for j in range(replayer.nominal_machine.n)]
    if len(members) > 1:
        try:
            repeats = align_repeats(members, [known[member.name] for member in members])
            if stage == "actuator":
                repeats = without_proportional_part(
                    repeats,
                    align_repeats(members, _filled_encoders(members)),
                    dt,
                    np.array([not record for record in records]),
                )
            floor = floor_of_repeats(repeats, dt)
            steps = [block_increments(repeat, dt) for repeat in repeat_deviations(repeats)]
        except DiagnosisError:
            floor = None
    if floor is None:
        stand_ins = [floor_without_repeats(rows, dt) for rows in known.values()]
        sigma = np.median([stand_in.whitener.innovation_sigma for stand_in in stand_ins], axis=0)
        floor = replace(stand_ins[0], whitener=Whitener(np.zeros((0, len(sigma))), sigma), increment_rms=sigma)
    least = _least_credible_sigma(stage, prepared) * np.array(
        [NOISELESS_SIGMA_MIN_FRAC if _is_remainder_zero(record) else 1.0 for record in records]
    )
    floor = _not_below(floor, least)
    if not any(records):
        return floor
    ar = np.zeros((max(len(record.ar) for record in records if record is not None), len(records)))
    for j, record in enumerate(records):
        if record is not None:
            ar[: len(record.ar), j] = record.ar
    sigma, rms = (
        np.array([getattr(record, name) if record else 0.0 for record in records]) for name in ("sigma", "rms")
    )
    both = with_remainder(floor, steps, ar, sigma, rms)
    believed = _not_below(both, least)
    return replace(
        believed, deviation_rms=np.where(sigma > 0.0, believed.deviation_rms, both.deviation_rms)
    )  # no remainder: as the repeats show


def _filled_encoders(members: tuple[Stretch, ...]) -> list[Array]:
    return [np.nan_to_num(fill_gaps(member.enc)) for member in members if member.enc is not None]


def _least_credible_sigma(stage: str, prepared: list[PreparedStretch]) -> Array:
    """The least sigma of an increment (n,) that is believed."""
    n = prepared[0].plant.n
    least = np.full(n, CREDIBLE_SIGMA_MIN_BY_STAGE[stage])
    if stage == "actuator":
        steps = [entry.stretch.enc_step for entry in prepared if entry.stretch.enc_step is not None]
        least = np.maximum(least, ROUNDING_SIGMA_STEP_FRAC * np.max(steps, axis=0, initial=0.0))
    return least


def _is_remainder_zero(record: Remainder | None) -> bool:
    """Whether a joint's stage left nothing in any baseline recording."""
    return record is not None and record.sigma == 0.0


def _not_below(floor: Floor, least: Array) -> Floor:
    """Sigma raised to what is believed; where there is no noise, the increments are taken as white.

    Returns: the floor with `deviation_rms` turned into the share of sigma that the repeats themselves show (n,).
    """
    sigma = floor.whitener.innovation_sigma
    a = np.where(sigma < WHITENING_SIGMA_MIN_FRAC * least, 0.0, floor.whitener.ar_coefficients)
    white = Whitener(a, np.maximum(sigma, least))
    share = np.minimum(1.0, sigma / white.innovation_sigma)
    return replace(floor, deviation_rms=share, whitener=white, increment_rms=np.maximum(floor.increment_rms, least))


def at_noise(floor: Floor, chosen: list[int], noise: Whitener) -> Floor:
    """A floor with another filter for some joints (0-based)."""
    n = len(floor.whitener.innovation_sigma)
    a, sigma, rms = np.zeros((noise.lag_count, n)), floor.whitener.innovation_sigma.copy(), floor.increment_rms.copy()
    a[:, chosen], sigma[chosen], rms[chosen] = noise.ar_coefficients, noise.innovation_sigma, noise.innovation_sigma
    return replace(floor, deviation_rms=np.ones(n), whitener=Whitener(a, sigma), increment_rms=rms)
