"""Stages that merge where the signal between them was not logged, run with what was logged before them."""

from dataclasses import dataclass, replace

import numpy as np

from diagnosis.log.tables import fill_gaps
from diagnosis.replay.course import smooth_course
from diagnosis.replay.replayer import PreparedStretch, Replayer
from diagnosis.replay.stretches import Stretch
from machine.effects.dynamics import Drive, drive_by_sent, drive_controller
from machine.effects.layout import ParameterSets
from machine.rotations import Array

INITIAL_VALVE_COMMAND = 0.0  # stretches begin at rest


@dataclass(frozen=True, slots=True)
class MergedStages:
    """The stages that one cell holds, since the signals between them were not logged."""

    stages: tuple[str, ...]


def merge_of(stretches: tuple[Stretch, ...]) -> MergedStages | None:
    """What a recording without valve commands merges; None where they are there, or nothing drives the joints."""
    if any(stretch.u is not None for stretch in stretches):
        return None
    if stretches and all(stretch.ref is not None for stretch in stretches):
        return MergedStages(("controller", "actuator"))
    if stretches and all(stretch.sent_reference is not None for stretch in stretches):
        return MergedStages(("link", "controller", "actuator"))
    return None


def merged_drives(
    replayer: Replayer, stretches: tuple[Stretch, ...], course: ParameterSets | None = None
) -> list[PreparedStretch]:
    """The stretches whose encoders can be replayed although no valve command was logged; none where one was."""
    merge = merge_of(stretches)
    if merge is None or not replayer.nominal_machine.has_controller:
        return []
    return [
        prepared for stretch in stretches if (prepared := merge_stages(replayer, stretch, merge, course)) is not None
    ]


def merge_stages(
    replayer: Replayer, stretch: Stretch, merge: MergedStages, course: ParameterSets | None = None
) -> PreparedStretch | None:
    """A stretch whose encoders are driven by the first signal that was logged; None where encoders are missing."""
    enc = stretch.enc
    if enc is None or not np.isfinite(enc).any(axis=0).all():
        return None
    plant, angles = replayer.at_rate(stretch.dt_s), fill_gaps(enc)
    loads = replayer.loads_along(angles)
    out = PreparedStretch(plant, {}, stretch)
    if "link" in merge.stages:
        if stretch.sent_reference is None:
            return None
        cycles = (stretch.row_count - 1) * plant.cycles_per_row + 1
        drive = drive_by_sent(
            plant, stretch.sent_reference.t_s, stretch.sent_reference.q, float(stretch.t_s[0]), cycles, loads
        )
        out.stage_inputs["actuator"] = replace(drive, enc_start=angles[0].copy())
        return out
    references = replayer.received_references(stretch, course)
    if references is None:
        return None
    seen = smooth_course(plant, angles)

    def driven(ref: Array) -> Drive:
        drive = drive_controller(plant, ref, seen, np.full(plant.n, INITIAL_VALVE_COMMAND), fine=True)
        return drive if loads is None else replace(drive, load=loads[0], load_kg=loads[1])

    out = replace(out, two_sided_alternatives=stretch.sent_reference is not None)
    out.stage_inputs["actuator"], out.alternative_inputs["actuator"] = (
        driven(references.best_estimate),
        references.alternatives,
    )
    if references.late_jump_variant is not None:
        out.late_jump_inputs["actuator"] = driven(references.late_jump_variant)
    return out
