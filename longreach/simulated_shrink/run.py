"""The simulator driven by a recording, once as the machine file is and once with the diagnosed effects, stretch by
stretch with effects that were fitted without it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from diagnosis.baseline.forward import entries_of
from diagnosis.diagnose import Diagnosis
from diagnosis.errors import DiagnosisError
from diagnosis.log.tables import filled
from diagnosis.replay.stretches import Stretch, repeat_groups
from longreach.simulated_shrink.compare import SKIPPED_S, Errors, positions, speeds
from longreach.simulated_shrink.held_out import HeldOut, effects_without
from longreach.simulated_shrink.points import (
    Places,
    measured_in_base,
    places_of,
    rows_at_rest,
    rows_during,
    simulated,
)
from longreach.simulated_shrink.seen import about_their_mean, eyes_of, object_places
from machine.description import Machine, parse_machine_toml
from machine.effects.entries import EffectEntry
from machine.errors import MachineError
from machine.rotations import Array
from sim_plc.command_side import LINK
from sim_plc.presets import PresetError
from sim_plc.recorded_drive import (
    Course,
    Offline,
    at_rest,
    follow_commands,
    follow_reference,
    follow_sent,
    offline,
    plain_world,
)
from sim_plc.world import World

Progress = Callable[[str, int, int], None]
USABLE = ("effects", "none")
JOINTS, COMMANDS, POINTS, SEEN = "references", "commands", "points", "camera"


class SimulatedShrinkError(Exception):
    """No such figure can be given; the text says why."""


@dataclass(frozen=True, slots=True)
class SimulatedRuns:
    """Errors of every stretch by what drove the plant: `references`, `commands`; `points` [m] of the tool.

    `held_out`: no stretch was simulated with numbers that it was used to fit; `sent`: driven by what the PC sent.
    """

    plant: str
    errors: dict[str, tuple[Errors, ...]]
    held_out: bool
    sent: bool
    seconds: float
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Both:
    """The two machines for one stretch, and all effects of each."""

    before: Offline
    after: Offline
    entries: tuple[tuple[EffectEntry, ...], tuple[EffectEntry, ...]]


def simulated_runs(found: Diagnosis, machine_text: str, progress: Progress = lambda *_: None) -> SimulatedRuns:
    """Drive the simulator's plant with every stretch of a diagnosed recording, without and with the effects.

    Raises: SimulatedShrinkError: an unsettled diagnosis, another arm than the simulator's, an effect that it cannot
            have, or nothing in the recording that could drive it.
    """
    if found.verdict.word not in USABLE:
        raise SimulatedShrinkError(f"the diagnosis is '{found.verdict.word}': there are no effects to simulate")
    try:
        machine = parse_machine_toml(machine_text)
        return _runs(found, machine, progress)
    except (MachineError, PresetError, DiagnosisError) as error:
        raise SimulatedShrinkError(str(error)) from error


def _runs(found: Diagnosis, machine: Machine, progress: Progress) -> SimulatedRuns:
    stretches = [stretch for stretch in found.whole.stretches if stretch.enc is not None and stretch.enc.shape[1] == 6]
    held = [effects_without(found, stretch) for stretch in stretches]
    plain = plain_world(machine)
    sent = any(entry.name in LINK for effects in held for entry in effects.entries)
    errors: dict[str, list[Errors]] = {JOINTS: [], COMMANDS: [], POINTS: [], SEEN: []}
    groups = _groups(found.whole.stretches)
    places_seen: tuple[list[Array], list[Array]] = ([], [])
    places = None if found.whole.nominal is None else places_of(found.whole.nominal, machine.T_flange_tcp)
    for number, (stretch, effects) in enumerate(zip(stretches, held, strict=True)):
        progress(f"simulating {stretch.name}", number, len(stretches))
        two = (machine.effects, (*machine.effects, *effects.entries))
        both = _Both(offline(plain, two[0]), offline(plain, two[1]), two)
        courses = _by_reference(both, stretch, sent)
        for name, error in _of_stretch(found, stretch, groups.get(stretch.name, ""), both, courses, places):
            errors[name].append(error)
        for kept, place in zip(places_seen, _seen(found, both, courses, stretch), strict=False):
            kept.append(place)
    errors[SEEN] = [Errors(before, after, "") for before, after in about_their_mean(*places_seen)]
    rest = _static(found, plain, machine, places)
    if rest is not None:
        errors[POINTS].append(rest)
    kept = {name: tuple(ones) for name, ones in errors.items() if ones}
    if not kept:
        raise SimulatedShrinkError(
            "nothing in the recording can drive the simulator: it needs encoders of 6 joints with received references "
            "or valve commands, or points of the last link at rest"
        )
    return SimulatedRuns(
        plant="the crane as preset 'ideal': rigid, no oil; it bends by what the machine file says",
        errors=kept,
        held_out=all(effects.held_out for effects in held),
        sent=sent,
        seconds=sum(stretch.duration_s for stretch in stretches),
        notes=_notes(held, rest is not None or SEEN in kept, places is None and _has_points(found)),
    )


def _notes(held: list[HeldOut], behind_too: bool, points_unplaced: bool) -> tuple[str, ...]:
    out = []
    if not all(effects.held_out for effects in held):
        out.append("some numbers were fitted on the stretch they are judged on: it is the only one of its kind")
    if behind_too:
        out.append("what was measured behind the encoders is judged with arm and camera numbers fitted on all of it")
    if points_unplaced:
        out.append("points are not judged: the machine file does not say where the tracker and a point of the tool are")
    return tuple(out)


def _has_points(found: Diagnosis) -> bool:
    tables = found.whole.tables
    return tables is not None and (tables.tracker is not None or tables.static is not None)


def _groups(stretches: tuple[Stretch, ...]) -> dict[str, str]:
    """Of each whole repeat of a command, which: part of an interrupted repeat does not repeat another part."""
    return {member.name: name for name, members in repeat_groups(stretches).items() for member in members}


def _of_stretch(
    found: Diagnosis, stretch: Stretch, group: str, both: _Both, courses: tuple[Course, ...], places: Places | None
) -> Iterator[tuple[str, Errors]]:
    """Errors of one stretch, by what drove the plant. `group`: which repeats of one command it belongs to, or none."""
    if stretch.enc is None:
        return
    enc, dt = filled(stretch.enc), stretch.dt_s
    if courses:
        pair = [positions(enc, course.q_encoder, dt) for course in courses]
        yield JOINTS, Errors(pair[0], pair[1], group)
        table = None if found.whole.tables is None else found.whole.tables.tracker
        if places is not None and table is not None:
            rows = rows_during(places, table, stretch, SKIPPED_S)
            if len(rows):
                measured, p_tcp = measured_in_base(places, table, rows)
                tracked = [measured - _points_at(course, stretch, table.t_s[rows], p_tcp) for course in courses]
                yield POINTS, Errors(tracked[0], tracked[1], "")
    if stretch.u is not None:
        u = filled(stretch.u)
        opened = [follow_commands(machine, stretch.t_s, u, enc[0]) for machine in (both.before, both.after)]
        pair = [speeds(enc, course.q_encoder, dt) for course in opened]
        yield COMMANDS, Errors(pair[0], pair[1], group)


def _by_reference(both: _Both, stretch: Stretch, sent: bool) -> tuple[Course, ...]:
    """Before and after, the loop closed by the simulator's controller; nothing without a reference."""
    if stretch.enc is None:
        return ()
    t_s, start, two = stretch.t_s, filled(stretch.enc)[0], (both.before, both.after)
    if sent and stretch.sent is not None:
        given = stretch.sent
        return tuple(follow_sent(machine, t_s, given.t_s, given.q, start) for machine in two)
    if stretch.ref is None:
        return ()
    ref = filled(stretch.ref)
    return tuple(follow_reference(machine, t_s, ref, start) for machine in two)


def _seen(found: Diagnosis, both: _Both, courses: tuple[Course, ...], stretch: Stretch) -> tuple[Array, ...]:
    """Where the object seems to be, before and after (m, 3) [m]; nothing without a camera."""
    nominal, tables = found.whole.nominal, found.whole.tables
    if not courses or nominal is None or nominal.camera is None or tables is None or tables.markers is None:
        return ()
    worlds = (both.before.world, both.after.world)
    return tuple(
        object_places(tables, eyes_of(nominal, world, entries), course, stretch)
        for world, entries, course in zip(worlds, both.entries, courses, strict=True)
    )


def _points_at(course: Course, stretch: Stretch, t_s: Array, p_tcp: Array) -> Array:
    """Simulated points (m, 3) at a tracker's times."""
    return simulated(course.at(stretch.t_s, t_s).tcp_poses(), p_tcp)


def _static(found: Diagnosis, plain: World, machine: Machine, places: Places | None) -> Errors | None:
    """Points measured at rest: the plant stood in each pose."""
    table = None if found.whole.tables is None else found.whole.tables.static
    if places is None or table is None or table.q is None or table.q.shape[1] != 6:
        return None
    rows = rows_at_rest(places, table)
    if not len(rows):
        return None
    named = tuple(entry for cell in found.cells for entry in entries_of(cell.chosen.fit))
    measured, p_tcp = measured_in_base(places, table, rows)
    pair = []
    for entries in (machine.effects, (*machine.effects, *named)):
        one = offline(plain, entries)
        Ts = np.array([at_rest(one, q) for q in table.q[rows]])
        pair.append(measured - simulated(Ts, p_tcp))
    return Errors(pair[0], pair[1], "")
