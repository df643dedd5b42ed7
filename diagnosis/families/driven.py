"""Families of functions for link, controller and actuator: of what drives them and of their own modelled course.

Never of what was measured at their end: that holds the very noise which the residual is made of.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from diagnosis.log.tables import filled
from diagnosis.noise.floor import Whitener, increments
from diagnosis.replay.stage_replay import LAST, OUTPUT, SKIPPED, Part, Replay, whiten_sets
from diagnosis.search.cell import Cell
from machine.effects.dynamics import simulate
from machine.effects.layout import ParameterSets
from machine.rotations import Array

KNOTS = 8
ORDERS = 24  # of a wave over the angle, a turn
SLOW_ORDERS = 4
SMOOTH_S = 0.045
LEAKS_S = (0.05, 0.3)
SINCE = "time since the start"


@dataclass(frozen=True, slots=True)
class Course:
    """Signals of one joint through a stretch, a row a log row (m,), and the time between two rows [s].

    `q`: the stage's own modelled output; `drive`: what it answers to; `load`: gravity's part; `others`: (m, k) the
    commands of the other joints; `t_s`: from the stretch's start; `since_s`: from the recording's.
    """

    dt_s: float
    t_s: Array
    q: Array
    drive: Array
    load: Array
    others: Array
    since_s: Array

    def rate(self, x: Array) -> Array:
        """d/dt of a signal."""
        return np.asarray(np.gradient(x, self.dt_s))

    def whole(self, x: Array) -> Array:
        """The integral over time of signals (m, k)."""
        return np.asarray(np.cumsum(x, axis=0) * self.dt_s)

    def leaking(self, x: Array, tau_s: float) -> Array:
        """Signals (m, k) integrated, with what was gathered leaking away: what has to be caught up with afterwards."""
        return np.asarray(_gathered(self.dt_s * x, np.exp(-self.dt_s / tau_s)))

    def smooth(self, x: Array) -> Array:
        """The mean over 45 ms."""
        n = min(max(1, round(SMOOTH_S / self.dt_s)), len(x))
        return np.convolve(x, np.ones(n) / n, mode="same")


@njit(cache=True)
def _gathered(x: Array, kept: float) -> Array:
    out = x.copy()
    for i in range(1, len(x)):
        out[i] += kept * out[i - 1]
    return out


def driven_columns(cell: Cell) -> dict[str, Array]:
    """Families by what they are functions of: (N, k), white as the cell's residual. Empty for other cells."""
    replay = cell.whitened
    if not isinstance(replay, Replay):
        return {}
    return families_white(cell, replay, lambda courses: families_of(cell.stage, courses))


def families_white(
    cell: Cell, replay: Replay, families: Callable[[list[Course]], list[dict[str, Array]]]
) -> dict[str, Array]:
    """Families of signals (N, k), white as the cell's residual. Args: families: of one joint, for each stretch."""
    out: dict[str, list[Array]] = {}
    modelled = modelled_of(cell, replay)
    for channel in range(len(replay.joints)):
        per_part = families(courses_of(cell, replay, modelled, channel))
        for name in per_part[0]:
            columns = [
                white_columns(replay.whitener, channel, part.stretch.dt_s, f[name])
                for part, f in zip(replay.parts, per_part, strict=True)
            ]
            out.setdefault(name, []).append(np.concatenate(columns))
    return {name: placed(cell, replay, blocks) for name, blocks in out.items()}


def courses_of(cell: Cell, replay: Replay, modelled: list[Array], channel: int) -> list[Course]:
    """One joint of a replay through each stretch. `modelled`: by `modelled_of`."""
    return [_course(cell, replay, *one, channel) for one in zip(replay.parts, modelled, strict=True)]


def families_of(stage: str, courses: list[Course], knots: Array | None = None) -> list[dict[str, Array]]:
    """Of one joint, for each stretch: families of signals (m, k) in the unit of the stage's output.

    Args: knots: of what drives it; where it lies most of the time if None.
    """
    family = {"link": _link, "controller": _controller, "actuator": _actuator}[stage]
    own = [_knots([getattr(one, name) for one in courses]) for name in ("drive", "q")]
    return [family(one, own[0] if knots is None else knots, own[1]) for one in courses]


def placed(cell: Cell, replay: Replay, blocks: list[Array]) -> Array:
    """Columns of each channel (its stretches end to end) at its rows, which lie stretch by stretch: each its own."""
    parts = len(replay.parts)
    lengths = np.bincount(cell.rows.series, minlength=parts * len(replay.joints))
    channels, edges = len(blocks), np.cumsum([0, *(block.shape[1] for block in blocks)])
    out = np.zeros((int(lengths.sum()), int(edges[-1])))
    starts = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    for channel, block in enumerate(blocks):
        own = lengths[channel::channels]
        cuts = np.split(block, np.cumsum(own)[:-1])
        for part in range(parts):
            first = int(starts[part * channels + channel])
            out[first : first + int(own[part]), edges[channel] : edges[channel + 1]] = cuts[part]
    return out


def modelled_of(cell: Cell, replay: Replay) -> list[Array]:
    """The stage's own output through each stretch (m, joints)."""
    chosen = ParameterSets(np.ascontiguousarray(cell.base.joint[:, list(replay.joints)]), cell.base.machine)
    runs = (simulate(part.plant, chosen, part.drive, LAST[cell.stage]) for part in replay.parts)
    return [np.asarray(getattr(one, OUTPUT[cell.stage])[0]) for one in runs]


def _course(cell: Cell, replay: Replay, part: Part, outputs: Array, channel: int) -> Course:
    stretch, j, modelled = part.stretch, replay.joints[channel], outputs[:, channel]
    m = len(modelled)
    u = filled(stretch.u)[:m] if stretch.u is not None else np.zeros((m, j + 1))
    drive = u[:, j]
    if cell.stage == "controller" and stretch.ref is not None and stretch.enc is not None:
        drive = (filled(stretch.ref) - filled(stretch.enc))[:m, j]
    if cell.stage == "link":
        drive = np.gradient(modelled, stretch.dt_s)
    load = part.drive.load[:m, channel] if len(part.drive.load) >= m else np.zeros(m)
    t_s, began_s = stretch.t_s[:m], min(one.stretch.t_s[0] for one in replay.parts)
    others = np.delete(u, j, axis=1)
    return Course(stretch.dt_s, t_s - t_s[0], modelled, drive, load, others, t_s - began_s)


def white_columns(whitener: Whitener, channel: int, dt_s: float, signals: Array) -> Array:
    """Increments of signals (m, k), through the filter that the residual went through."""
    k = signals.shape[1]
    same = Whitener(np.repeat(whitener.a[:, [channel]], k, axis=1), np.repeat(whitener.sigma[[channel]], k))
    return whiten_sets(same, increments(signals, dt_s)[None])[0, SKIPPED:]


def _knots(signals: list[Array]) -> Array:
    return np.unique(np.quantile(np.concatenate(signals), np.linspace(0.0, 1.0, KNOTS)))


def _with_ends(knots: Array) -> Array:
    """Knots at even distances, too: what happens at the largest sizes only lies between the last two quantiles."""
    return np.unique(np.concatenate([knots, np.linspace(knots[0], knots[-1], 2 * KNOTS)]))


def hats(x: Array, knots: Array) -> Array:
    """Straight pieces between knots: any continuous function of x (m, knots)."""
    return np.stack([np.interp(x, knots, row) for row in np.eye(len(knots))], axis=1)


def moving_families(c: Course) -> dict[str, Array]:
    """Of an actuator: families that go with how the joint moves, not only with what it was told to do."""
    v, du, size = c.smooth(c.rate(c.q)), c.rate(c.smooth(c.drive)), np.abs(c.drive)
    busy = np.abs(c.others).sum(axis=1)
    turned = np.stack([np.sign(du), np.sign(du) * size], axis=1)
    return {
        "the change of the command": np.concatenate(
            [np.stack([c.drive, size, v, c.rate(v)], axis=1), c.whole(turned)], axis=1
        ),
        "the load": c.whole(np.stack([c.load, v * c.load, np.abs(v) * c.load, c.load**2], axis=1)),
        "the angle": np.concatenate(
            [c.whole(v[:, None] * np.stack([c.q, c.q**2], axis=1)), _waves(c.q, SLOW_ORDERS)], axis=1
        ),
        "other joints": np.concatenate([c.whole(np.stack([v * busy, np.sign(v) * busy], axis=1)), c.others], axis=1),
    }


def _waves(q: Array, orders: int) -> Array:
    turns = np.outer(q, np.arange(1, orders + 1))
    return np.concatenate([np.sin(turns), np.cos(turns)], axis=1)


def _actuator(c: Course, knots: Array, _: Array) -> dict[str, Array]:
    v, minutes = c.smooth(c.rate(c.q)), c.since_s / 60.0
    return {
        "the valve command": c.whole(hats(c.drive, knots)),
        **moving_families(c),
        "waves over the angle": _waves(c.q, ORDERS),
        "time": c.whole(np.stack([np.ones_like(v), c.t_s, v * c.t_s, np.abs(v) * c.t_s], axis=1)),
        SINCE: c.whole(np.stack([minutes, v * minutes, np.abs(v) * minutes], axis=1)),  # oil that warms
    }


def _controller(c: Course, knots: Array, own_knots: Array) -> dict[str, Array]:
    de, du = c.rate(c.drive), c.rate(c.q)
    return {
        "its error": hats(c.drive, knots),
        "the valve command": hats(c.q, own_knots),
        "change": np.stack([c.drive, de, du, c.rate(du), np.abs(c.q)], axis=1),
        "time": np.stack([c.drive * c.t_s, c.q * c.t_s], axis=1),
    }


def _link(c: Course, knots: Array, _: Array) -> dict[str, Array]:
    dv, speeds = c.rate(c.drive), hats(c.drive, _with_ends(knots))
    return {
        "speed": np.concatenate([speeds, *(c.leaking(speeds, tau_s) for tau_s in LEAKS_S)], axis=1),
        "change": np.stack([c.drive, dv, c.rate(dv), np.abs(c.drive)], axis=1),
        "time": np.stack([c.drive * c.t_s], axis=1),
    }
