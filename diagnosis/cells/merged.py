"""Where the valve command was not logged: the stages up to the encoder as one cell, run with what was logged before it.

From the received reference (controller and actuator merge) or, without it, from the one that was sent (the link too).
"""

from dataclasses import replace

from diagnosis.cells.dynamic import cell_of, is_effect_possible
from diagnosis.replay.merge import MergedStages, merge_of, merged_drives
from diagnosis.replay.replayer import Replayer
from diagnosis.replay.stage_floor import stage_floor
from diagnosis.replay.stretches import Stretch
from diagnosis.search.candidates import SUPPLY_DROOP_EFFECT, Candidate, candidates_of, candidates_of_effects
from diagnosis.search.cell import Cell
from machine.effects.layout import ParameterSets


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

    everything, droop = tuple(range(replayer.nominal_machine.n)), candidates_of_effects((SUPPLY_DROOP_EFFECT,), ())
    if "link" in merge.stages:
        return [cell(everything, (*_merged_candidates(merge, everything, replayer), *droop))], None
    found = [cell((j,), _merged_candidates(merge, (j,), replayer)) for j in everything]
    return found, cell(everything, droop) if len(everything) > 1 else None


def _merged_candidates(merge: MergedStages, joints: tuple[int, ...], replayer: Replayer) -> tuple[Candidate, ...]:
    """What may be wrong with joints (0-based), each by itself; of the link, too, where it is among what merges."""
    found = tuple(
        candidate
        for stage in merge.stages
        for candidate in candidates_of(stage, tuple(j + 1 for j in joints), stage == "link")  # pyright: ignore[reportArgumentType]
    )
    return tuple(
        candidate
        for candidate in found
        if candidate.name != SUPPLY_DROOP_EFFECT and is_effect_possible(candidate, replayer, replayer.torque_reference)
    )
