"""Whether the chosen model leaves something behind: tests of its held-out residual, and the lead they give."""

import re
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, erfc, fdtrc  # scipy.stats takes a second to import

from diagnosis.cells.behind import independent
from diagnosis.families.common import COMMON_LEAST, common_share, repeated_rows
from diagnosis.replay.stage_replay import Replay
from diagnosis.search.cell import DRIVEN_STAGES, Cell
from diagnosis.search.score import Score
from machine.remainder import USUAL_ENERGY, USUAL_NATS
from machine.rotations import Array

LEVEL = 1e-3  # of all tests of a recording together (Bonferroni)
LAGS = 20
UNLIKE_TIMES = 2.0  # of what is asked of a joint that moved as no undisturbed recording shows, or beside one
REMAINDER_VARIES = 1.0  # a swing's energy may be twice as large in one motion as it is on the average
# A test counts only if what it finds is also large: with thousands of rows everything is significant.
ENERGY_MIN = 0.7  # chi2/n beyond 1: a gap of 0.84 floors; a few repeats know the floor to a quarter
AUTOCORRELATION_MIN = 0.08  # sum of squares over 20 lags, besides what chance and a filter from few repeats give
AUTOCORRELATION_CHANCE = 60.0  # over the number of rows
UNREST = "unrest"
CORRELATION = "correlation"
BY_ITSELF = "moves by itself"
EDGE = "edge"
QUIET_MAX = 0.1  # of the floor's energy: an undisturbed stage that never leaves more is quiet
QUIET_TIMES = 1.5  # the most that it ever left
SPARED_BLOCKS = 2
EXCESS_MIN = 0.1  # of the noise's own energy: a pattern without more energy than the noise is the filter's error
CORRELATION_MIN = 0.15
PEAK_MIN = 0.06  # share of the variance in one period of time or position
PERIODS = 200
PATTERN_NATS = 12.0  # of what a pattern explains, after the spread: twice the margin of a name
BEHIND_NATS = 40.0  # the same for points and corners beside a baseline: few, and what a boom does to one it does to all
BEHIND_TIMES = 3.0
USUAL_TIMES = 2.0  # a test that fires on the undisturbed machine counts only beyond this share of its size there


@dataclass(frozen=True, slots=True)
class Fired:
    """One test that fired: which, how large, its p-value, what the remainder goes with, its share of the energy."""

    test: str
    stage: str
    joint: int | None
    size: float
    p_value: float
    lead: str
    share: float = 1.0


def remainder(cell: Cell, chosen: Score, cells: int) -> tuple[Fired, ...]:
    """The tests that fire at the chosen model, the largest first.

    Args: cells: how many cells are tested in this recording.
    """
    r = np.clip(chosen.held_out, -30.0, 30.0)
    if not cell.parts:
        return tests_of(cell, r, cells)
    told = {"spread_least": cell.spread_least, "unlike": cell.unlike, "stuck": cell.stuck}
    number = cells + len(cell.parts) - 1
    found = [one for part, own in cell.by_part(r) for one in tests_of(replace(part, **told), own, number)]
    return tuple(sorted(found, key=lambda one: (one.lead == "", -one.size)))


def tests_of(cell: Cell, r: Array, cells: int) -> tuple[Fired, ...]:
    """The tests of one residual (N,) that fire beyond what is usual on the undisturbed machine."""
    if cell.restless:  # it made the noise, too: no residual is large beside it
        return (Fired(BY_ITSELF, cell.stage, cell.joint, 1.0, 0.0, cell.restless),)
    if cell.knocked or 0.5 * (float(r @ r) - _noise(cell) * len(r)) < cell.least_nats:
        return ()
    n_tests = cells * (4 + len(cell.regressors))
    level = LEVEL / max(n_tests, 1)
    found = [*_energy(cell, r), *_unrest(cell, r)]
    if cell.joint not in cell.moved_unlike:  # what it leaves of another motion goes on in another way
        beside = cell.stage == "actuator" and bool(cell.moved_unlike)  # one oil feeds them all
        found += _patterns(cell, r, UNLIKE_TIMES if beside else 1.0)
    usual = dict(cell.usual)
    least, times = (PATTERN_NATS, USUAL_TIMES)
    if usual and cell.stage not in DRIVEN_STAGES:
        least, times = BEHIND_NATS, BEHIND_TIMES
    least_nats = least + times * usual.get(USUAL_NATS, 0.0) / cell.spread_least
    worth = 0.5 * float(r @ r) / cell.spread_least  # [nats] of the whole residual, by the ruler that names are held to
    kept = [
        one
        for one in found
        if one.p_value < level
        and one.size > USUAL_TIMES * usual.get(key_of(one), 0.0)
        and one.share * worth > least_nats
    ]
    return tuple(sorted(kept, key=lambda one: (one.lead == "", -one.size)))


def at_edge(cell: Cell, chosen: Score) -> tuple[Fired, ...]:
    """Names that fit only at the end of what is believed of their size: a foreign cause bends them that far."""
    found = []
    for effect, here in chosen.fit.slices:
        sizes = [slot.parameter == effect.slots[0].parameter for slot in effect.slots]
        for slot, size, is_size, ends in zip(
            effect.slots, chosen.fit.theta[here], sizes, chosen.fit.at_bound[here], strict=True
        ):
            nothing = abs(size - np.clip(slot.neutral, slot.low, slot.highest)) <= 1e-3 * (slot.high - slot.low)
            if is_size and ends and not nothing and not effect.read_off:
                lead = f"is small only if {effect.name} is {size:.3g}, the most that is believed of it"
                found.append(Fired(EDGE, cell.stage, effect.joint, 1.0, 0.0, lead))
    return tuple(found)


def _patterns(cell: Cell, r: Array, least: float) -> list[Fired]:
    """What goes on in time, with a period or a signal. `least`: share of its least size that a pattern must have."""
    # Below the floor a pattern is as small as the residual it is found in.
    quiet = min(1.0, float(np.mean(r**2))) / least
    return [*_autocorrelation(cell, r, quiet), *_peaks(cell, r, quiet), *_correlations(cell, r, quiet)]


def pattern_nats(cell: Cell, r: Array) -> float:
    """The most that any pattern explains of a residual (N,) [nats, not divided], however small."""
    return max((one.share for one in _patterns(cell, r, 1e-6)), default=0.0) * 0.5 * float(r @ r)


def key_of(one: Fired) -> str:
    """A test's name with what it goes with, without numbers: what happens on one joint may happen on another."""
    return re.sub(r" \d+$", "", f"{one.test} {one.lead.split(',')[0].split(' over ')[0]}".strip())


def _energy(cell: Cell, r: Array) -> list[Fired]:
    """More energy than the floor has; none behind joints that moved unlike: so did the booms that they set swinging.

    What booms do differs from day to day by more than what oil does: there twice the most that was ever left is asked.
    So it is of a joint that moved unlike itself: behind commands cut to square waves oil left 2.3 and 2.8.
    """
    behind = cell.stage not in DRIVEN_STAGES
    if cell.moved_unlike and behind:
        return []
    n = len(r)
    ratio = float(r @ r) / n
    least = 1.0 + ENERGY_MIN + REMAINDER_VARIES * cell.left_share
    if behind:
        least = max(least, USUAL_TIMES * dict(cell.usual).get(USUAL_ENERGY, 0.0))
    elif cell.joint in cell.moved_unlike:
        least *= UNLIKE_TIMES
    if ratio < least or not cell.floor_known:
        return []
    few = cell.floor_squares  # six pairs of poses know a floor to an eighth: such a ratio is no chi2
    p_value = float(fdtrc(n, few, ratio) if few else chdtrc(n, r @ r))
    return [Fired("energy", cell.stage, cell.joint, ratio, p_value, "", 1.0 - 1.0 / ratio)]


def _unrest(cell: Cell, r: Array) -> list[Fired]:
    """More than a quiet stage has ever left on the undisturbed machine, however far below what is believed as floor.

    Why: what a PLC's program does repeats to a rounding, day by day. A floor there says what moves the tip, not what is
    usual; a command in steps of a tenth of a millimetre is a fault all the same.
    """
    if not _is_quiet(cell) or not cell.floor_known:
        return []
    ratio, least = steady_energy(cell, r), QUIET_TIMES * dict(cell.usual)[USUAL_ENERGY] + _noise(cell)
    if ratio <= least:
        return []
    p_value = float(chdtrc(len(r), ratio * len(r) / least)) if least > 0.0 else 0.0
    lead = "is more than the undisturbed machine ever left there"
    return [Fired(UNREST, cell.stage, cell.joint, ratio, p_value, lead, 1.0 - least / ratio)]


def _is_quiet(cell: Cell) -> bool:
    """Whether the undisturbed machine leaves hardly anything here."""
    return dict(cell.usual).get(USUAL_ENERGY, 1.0) <= QUIET_MAX


def _noise(cell: Cell) -> float:
    """The noise's own energy. None of a link that repeats to a rounding undisturbed and has lost datagrams: these are
    what differs from one repeat to the next, and would hide themselves.
    """
    return 0.0 if cell.stage == "link" and _is_quiet(cell) and _lost_some(cell) else cell.quiet


def _lost_some(cell: Cell) -> bool:
    """Whether the log's own numbers show that datagrams never came."""
    parts = cell.whitened.parts if isinstance(cell.whitened, Replay) else ()
    sent = [part.stretch.sent for part in parts]
    return any(one is not None and one.lost is not None and bool(one.lost.any()) for one in sent)


def steady_energy(cell: Cell, r: Array) -> float:
    """Mean square of a residual (N,) without its strongest blocks: a late packet or two in a month are no habit."""
    block = cell.rows.block if cell.rows.whole is None else cell.rows.whole
    by_block = np.sort(np.bincount(block, weights=r**2))
    return float(by_block[:-SPARED_BLOCKS].sum()) / len(r)


def _autocorrelation(cell: Cell, r: Array, quiet: float) -> list[Fired]:
    """Ljung-Box over 20 lags, each series on its own, pooled."""
    if cell.stage not in DRIVEN_STAGES or float(np.mean(r**2)) < (1.0 + EXCESS_MIN) * cell.quiet:
        return []
    total, count = np.zeros(LAGS), 0
    for number in np.unique(cell.rows.series):
        x = r[cell.rows.series == number]
        x = x - x.mean()
        power = float(x @ x)
        if len(x) <= 3 * LAGS or power == 0.0:
            continue
        total += len(x) * np.array([float(x[k:] @ x[:-k]) / power for k in range(1, LAGS + 1)])
        count += len(x)
    if count == 0:
        return []
    rho = total / count
    q = count * float(rho @ rho)
    if float(rho @ rho) * quiet**2 < AUTOCORRELATION_MIN + AUTOCORRELATION_CHANCE / count:
        return []
    lag = int(np.argmax(np.abs(rho))) + 1
    lead = f"goes on over {lag * 0.05:.2g} s"
    size = float(rho @ rho)
    share = min(1.0, size)  # what its own past explains of it
    return [Fired("autocorrelation", cell.stage, cell.joint, size, float(chdtrc(LAGS, q)), lead, share)]


def _correlations(cell: Cell, r: Array, quiet: float) -> list[Fired]:
    found = []
    x, repeats = r - r.mean(), repeated_rows(cell)
    for name, values in cell.regressors:
        y = values - values.mean()
        power_y = float(y @ y)
        power = float(np.sqrt((x @ x) * power_y))
        if power == 0.0:
            continue
        rho = float(x @ y) / power
        p = float(erfc(abs(rho) * np.sqrt(0.5 * independent(cell, len(x)))))  # two-sided
        if abs(rho) * np.sqrt(quiet) <= CORRELATION_MIN:
            continue
        if common_share(x, y * float(x @ y) / power_y, repeats) >= COMMON_LEAST:
            found.append(Fired(CORRELATION, cell.stage, cell.joint, abs(rho), p, f"goes with {name}", rho**2))
    return found


def _peaks(cell: Cell, r: Array, quiet: float) -> list[Fired]:
    """Lomb's periodogram of the residual over time, and over position (eccentric gears, resonances)."""
    found = []
    axes = [("time", cell.t_s, "Hz")] if cell.stage in DRIVEN_STAGES else []
    axes += [(name, x, "per turn") for name, x in cell.regressors if name == "position" or name.startswith("joint ")]
    for name, values, unit in axes:
        span = float(np.ptp(values))
        if span <= 0.0 or len(values) < 100:
            continue
        # At least three periods, at most one in four samples or different positions; over position up to 60 a turn.
        least = 3.0 / min(span, 60.0 if name == "time" else span)
        most = 5.0 if name == "time" else min(60.0 / (2.0 * np.pi), 0.25 * len(np.unique(values.round(3))) / span)
        if most <= least:
            continue
        f = np.linspace(least, most, PERIODS)
        share = _lomb(values, r, f)
        best = int(np.argmax(share))
        if share[best] * quiet < PEAK_MIN:
            continue
        p = min(1.0, PERIODS * float(np.exp(-0.5 * independent(cell, len(r)) * share[best])))
        shown = f[best] if name == "time" else f[best] * 2.0 * np.pi
        lead, size = f"periodic in {name}, {shown:.3g} {unit}", float(share[best])
        found.append(Fired("peak", cell.stage, cell.joint, size, p, lead, size))
    return found


def _lomb(x: Array, y: Array, frequencies: Array) -> Array:
    """Share of y's variance in a sine of each frequency (f,)."""
    y = y - y.mean()
    power = float(y @ y) or 1.0
    shares = []
    for f in frequencies:
        basis = np.stack([np.cos(2.0 * np.pi * f * x), np.sin(2.0 * np.pi * f * x)], axis=1)
        coefficients = np.linalg.lstsq(basis, y, rcond=None)[0]
        shares.append(float(np.sum((basis @ coefficients) ** 2)) / power)
    return np.array(shares)
