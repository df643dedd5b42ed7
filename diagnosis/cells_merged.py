"""Where the valve command was not logged: the stages up to the encoder as one cell, run with what was logged before it.

From the received reference (controller and actuator merge) or, without it, from the one that was sent (the link too).
"""

from dataclasses import dataclass, replace

import numpy as np

from diagnosis.candidates import DROOP, Candidate, candidates_of, named
from diagnosis.cells import Cell
from diagnosis.cells_dynamic import cell_of, possible
from diagnosis.course import smooth
from diagnosis.replay import Prepared, Replayer
from diagnosis.stage_floor import stage_floor
from diagnosis.stretches import Stretch
from diagnosis.tables import filled
from machine.effects.dynamics import Drive, drive_by_sent, drive_controller
from machine.effects.layout import ParameterSets
from machine.rotations import Array

START_COMMAND = 0.0  # stretches begin at rest


@dataclass(frozen=True, slots=True)
class Merge:
    """The stages that one cell holds, and the signals whose absence merges them."""

    stages: tuple[str, ...]
    missing: tuple[str, ...]


def merge_of(stretches: tuple[Stretch, ...]) -> Merge | None:
    """What a recording without valve commands merges; None where they are there, or nothing drives the joints."""
    if any(one.u is not None for one in stretches):
        return None
    if stretches and all(one.ref is not None for one in stretches):
        return Merge(("controller", "actuator"), ("u_<j>_frac",))
    if stretches and all(one.sent is not None for one in stretches):
        return Merge(("link", "controller", "actuator"), ("q_ref_<j>_rad", "u_<j>_frac"))
    return None


def merged_cells(
    replayer: Replayer, stretches: tuple[Stretch, ...], base: ParameterSets, course: ParameterSets | None = None
) -> tuple[list[Cell], Cell | None]:
    """The joints one by one, and all of them as one for what couples them, if there are several; one cell alone where
    the link is among what merges: a late link moves them all. `course`: what is known of the link, if it is judged.
    """
    merge, prepared = merge_of(stretches), merged_drives(replayer, stretches, course)
    if merge is None or not prepared:
        return [], None
    floor = stage_floor(replayer, "actuator", prepared, base)

    def cell(joints: tuple[int, ...], candidates: tuple[Candidate, ...]) -> Cell:
        made = cell_of("actuator", joints, prepared, floor, base, replayer)
        return replace(made, candidates=candidates)

    everything, droop = tuple(range(replayer.nominal.n)), named((DROOP,), ())
    if "link" in merge.stages:
        return [cell(everything, (*_candidates(merge, everything, replayer), *droop))], None
    found = [cell((j,), _candidates(merge, (j,), replayer)) for j in everything]
    return found, cell(everything, droop) if len(everything) > 1 else None


def merged_drives(
    replayer: Replayer, stretches: tuple[Stretch, ...], course: ParameterSets | None = None
) -> list[Prepared]:
    """The stretches whose encoders can be replayed although no valve command was logged; none where one was."""
    merge = merge_of(stretches)
    if merge is None or not replayer.nominal.has_controller:
        return []
    return [one for stretch in stretches if (one := merged(replayer, stretch, merge, course)) is not None]


def merged(replayer: Replayer, stretch: Stretch, merge: Merge, course: ParameterSets | None = None) -> Prepared | None:
    """A stretch whose encoders are driven by the first signal that was logged; None where encoders are missing."""
    enc = stretch.enc
    if enc is None or not np.isfinite(enc).any(axis=0).all():
        return None
    plant, angles = replayer.at_rate(stretch.dt_s), filled(enc)
    loads = replayer.loads(angles)
    out = Prepared(plant, {}, stretch)
    if "link" in merge.stages:
        if stretch.sent is None:
            return None
        cycles = (stretch.rows - 1) * plant.decimate + 1
        drive = drive_by_sent(plant, stretch.sent.t_s, stretch.sent.q, float(stretch.t_s[0]), cycles, loads)
        out.drives["actuator"] = replace(drive, enc_start=angles[0].copy())
        return out
    references = replayer.references(stretch, course)
    if references is None:
        return None
    seen = smooth(plant, angles)

    def driven(ref: Array) -> Drive:
        drive = drive_controller(plant, ref, seen, np.full(plant.n, START_COMMAND), fine=True)
        return drive if loads is None else replace(drive, load=loads[0], load_kg=loads[1])

    out = replace(out, sided=stretch.sent is not None)
    out.drives["actuator"], out.others["actuator"] = driven(references.own), references.others
    if references.jumped is not None:
        out.late["actuator"] = driven(references.jumped)
    return out


def _candidates(merge: Merge, joints: tuple[int, ...], replayer: Replayer) -> tuple[Candidate, ...]:
    """What may be wrong with joints (0-based), each by itself; of the link, too, where it is among what merges."""
    found = tuple(
        one
        for stage in merge.stages
        for one in candidates_of(stage, tuple(j + 1 for j in joints), stage == "link")  # pyright: ignore[reportArgumentType]
    )
    return tuple(one for one in found if one.name != DROOP and possible(one, replayer, replayer.torque_reference))
