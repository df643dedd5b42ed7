"""Joints that did not move as those of an undisturbed machine do, since what commanded them was far off.

A command that is cut to a square wave drives the oil and the booms through motions that no undisturbed recording holds.
What a baseline is known to leave there is then known of other motions only. A joint that sticks moves in jumps, and
knocks at the joints beside it and at the booms behind.
"""

from dataclasses import replace

import numpy as np

from diagnosis.noise.floor import increments
from diagnosis.replay.stage_replay import Replay, part_increments
from diagnosis.search.candidates import SEEN_IN_MOTION, SWINGS, put
from diagnosis.search.cell import Cell
from diagnosis.search.score import STICKS
from diagnosis.search.search import Search, searched_without
from machine.effects.layout import ParameterSets

UNLIKE_NATS = 100.0  # for a name where the joint moved unlike: after a square wave a lag gained 61
LATE = ("transport_delay",)
FAR_OFF = 0.1  # of a command's own changes, RMS: a lag or gain that is off by some per cent still moves the joint alike


def far_off(found: list[Search]) -> tuple[int, ...]:
    """Joints (1-based) whose reference or valve command changed by a tenth of itself unlike their model's.

    What comes late is no other motion: a delay that was found is no news here.
    """
    return tuple(sorted({joint for one in found for joint in _far_off(one)}))


def _far_off(found: Search) -> list[int]:
    replay, base = found.cell.whitened, found.cell.base
    if not isinstance(replay, Replay) or replay.stage == "actuator":
        return []
    for effect, numbers in found.chosen.fit.by_effect:
        if effect.name in LATE:
            base = put(base, (effect,), numbers)
    chosen = ParameterSets(np.ascontiguousarray(base.joint[:, list(replay.joints)]), base.machine)
    off = np.concatenate([part_increments(replay.stage, part, chosen)[0][0] for part in replay.parts])
    own = np.concatenate([increments(part.measured, part.stretch.dt_s) for part in replay.parts])
    shares = np.mean(off**2, axis=0) > FAR_OFF**2 * np.mean(own**2, axis=0)
    return [joint + 1 for joint, share in zip(replay.joints, shares, strict=True) if share]


def marked(cell: Cell, joints: tuple[int, ...]) -> Cell:
    """The cell, told of these joints, too; its own joint's names are asked for more."""
    if cell.stage == "actuator" and cell.joint in joints:
        cell = replace(cell, least_nats=max(cell.least_nats, UNLIKE_NATS))
    return replace(cell, unlike=tuple(sorted({*cell.unlike, *joints}))) if joints else cell


def told_who_sticks(found: list[Search]) -> list[Search]:
    """Searches of the actuators, told which joints were found to stick."""
    stuck = _stuck(found)
    return [replace(one, cell=replace(one.cell, stuck=stuck)) for one in found] if stuck else found


def nothing_sticks(found: Search) -> Search:
    """The same search, of a machine on which nothing was found to stick."""
    return replace(found, cell=replace(found.cell, stuck=())) if found.cell.stuck else found


def told_beyond(behind: list[Search], dynamic: list[Search]) -> list[Search]:
    """What was searched behind the joints, told of all joints that moved unlike.

    A swing is no news where a joint sticks: its jumps set booms swinging as no undisturbed recording shows. Where one
    moved unlike, a baseline knows of other motions only how the booms follow: a name of that has to gain as much there
    as one of the actuator (beside a command cut to a square wave a play gained 21 nats).
    """
    joints, stuck = tuple({joint for one in dynamic for joint in one.cell.unlike}), _stuck(dynamic)
    if stuck:
        behind = [_unless_clear(one, SWINGS, np.inf) for one in behind]
    if joints:
        behind = [_unless_clear(one, SEEN_IN_MOTION, UNLIKE_NATS) if one.cell.usual_known else one for one in behind]
    return [replace(one, cell=replace(marked(one.cell, joints), stuck=stuck)) for one in behind]


def _unless_clear(found: Search, names: tuple[str, ...], least_nats: float) -> Search:
    """The search without those of these names that were chosen and gain less than so much."""
    for name in names:
        if any(effect.name == name for effect in found.chosen.fit.hypothesis):
            rest = searched_without(found, name)
            found = rest if found.chosen.total - rest.chosen.total < least_nats * found.spread else found
    return found


def _stuck(found: list[Search]) -> tuple[int, ...]:
    """Joints (1-based) that were found to stick."""
    named = (effect for one in found for effect in one.chosen.fit.hypothesis)
    return tuple(effect.joint for effect in named if effect.name == STICKS and effect.joint is not None)
