"""What a log shows by itself, and no fit would find: the step of a rounded reference, lost datagrams, limits passed.

With a step s and a range of 1 rad, a size wrong by s^2 / 1 rad already rounds differently at the far end; and which
datagrams were lost is in their numbers, not in how many they were.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.replay.stretches import Stretch
from diagnosis.search.candidates import Candidate
from machine.rotations import Array

LOGGED_REFERENCE_EFFECTS = ("reference_quantisation", "reference_rate_limit")  # not seen where q_ref was not logged
DISTINCT_VALUES_MIN = 12  # different values, before any comb is believed
DISTINCT_VALUE_STEP_MIN_RAD = 1e-8  # below it two values are the same one, written twice
QUANTISATION_ERROR_MAX_FRAC = 0.05  # of the step, RMS: how far values may lie off the comb (the log's own rounding)
STEP_DIVISORS = (1, 2, 3, 4)
COMMAND_LIMIT_MIN_FRAC = 0.98  # of the largest command in the log: no limit lies below it
FIXED_SIZE_TOLERANCE_FRAC = 1e-7  # of the size: what a fit may still move


def read_off(candidates: tuple[Candidate, ...], stretches: tuple[Stretch, ...]) -> tuple[Candidate, ...]:
    """Candidates of the link, with the size fixed where the log shows it; no loss where it shows that there is none."""
    if not all(stretch.ref_logged for stretch in stretches):
        candidates = tuple(candidate for candidate in candidates if candidate.name not in LOGGED_REFERENCE_EFFECTS)
    values = np.concatenate([stretch.ref for stretch in stretches if stretch.ref is not None])
    loss = _datagram_losses(stretches)
    out = []
    for candidate in candidates:
        if candidate.name == "reference_quantisation" and candidate.joint is not None:
            out.append(_fix_candidate_size(candidate, comb_of(values[:, candidate.joint - 1])))
        elif candidate.name != "packet_loss" or loss is None:
            out.append(candidate)
        elif loss.any():
            fixed = _fix_candidate_size(candidate, float(loss.mean()))
            out.append(candidate if fixed is candidate else replace(fixed, share_sample_count=len(loss)))
    return tuple(out)


def candidates_within_log(candidates: tuple[Candidate, ...], stretches: tuple[Stretch, ...]) -> tuple[Candidate, ...]:
    """Candidates of controllers, without limits of the command that the log itself goes beyond."""
    out = []
    for candidate in candidates:
        if candidate.name != "controller_saturation" or candidate.joint is None:
            out.append(candidate)
            continue
        slot = candidate.parameter_slots[0]
        logged = [np.abs(part.u[:, candidate.joint - 1]) for part in stretches if part.u is not None]
        known = [float(u[np.isfinite(u)].max(initial=0.0)) for u in logged]
        least = COMMAND_LIMIT_MIN_FRAC * max(known, default=0.0)
        if least < slot.upper_bound:
            low = max(slot.lower_bound, least)
            out.append(
                replace(
                    candidate, parameter_slots=(replace(slot, lower_bound=low, start_value=max(slot.start_value, low)),)
                )
            )
    return tuple(out)


def _datagram_losses(stretches: tuple[Stretch, ...]) -> NDArray[np.bool_] | None:
    """Of every datagram that can be judged whether it never arrived; None where some stretch cannot show it."""
    seen = [stretch.sent_reference for stretch in stretches if stretch.sent_reference is not None]
    known = [
        sent.datagram_lost if sent.loss_observable is None else sent.datagram_lost[sent.loss_observable]
        for sent in seen
        if sent.datagram_lost is not None
    ]
    return np.concatenate(known) if known and len(known) == len(seen) else None


def _fix_candidate_size(candidate: Candidate, size: float | None) -> Candidate:
    slot = candidate.parameter_slots[0]
    if size is None or not slot.lower_bound < size < slot.upper_bound:
        return candidate
    low, high = size * (1.0 - FIXED_SIZE_TOLERANCE_FRAC), size * (1.0 + FIXED_SIZE_TOLERANCE_FRAC)
    return replace(
        candidate,
        parameter_slots=(replace(slot, lower_bound=low, typical_max=high, upper_bound=high, start_value=size),),
        read_off=True,
    )


def comb_of(values: Array) -> float | None:
    """The step of which all values (m,) are whole multiples; None where there is none to be seen."""
    x = np.unique(values[np.isfinite(values)])
    steps = np.diff(x)
    x, steps = x[np.append(True, steps > DISTINCT_VALUE_STEP_MIN_RAD)], steps[steps > DISTINCT_VALUE_STEP_MIN_RAD]
    if len(x) < DISTINCT_VALUES_MIN:
        return None
    # A comb's steps are few and equal; without one the smallest of thousands is chance, and nothing else fits it.
    found = (_refine_step_size(float(steps.min()) / divisor, x) for divisor in STEP_DIVISORS)
    return next((step for step in found if step is not None), None)


def _refine_step_size(step: float, x: Array) -> float | None:
    """The step made exact, from neighbours outwards: each width is numbered by what the smaller ones gave."""
    centre = float(x[len(x) // 2])
    width = 8.0 * step
    while True:
        near = x[np.abs(x - centre) <= width] - centre
        k = np.round(near / step)
        if float(k @ k) == 0.0:
            return None
        step = float(near @ k) / float(k @ k)
        if len(near) == len(x):
            break
        width *= 2.0
    k = np.round(x / step)
    step = float(x @ k) / float(k @ k)
    off = float(np.sqrt(np.mean((x - step * np.round(x / step)) ** 2)))
    return step if off < QUANTISATION_ERROR_MAX_FRAC * step else None
