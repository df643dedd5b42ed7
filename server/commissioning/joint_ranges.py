"""Step: every encoder is quiet and inside its range; on request every joint is driven to its ends by lever."""

import math
from collections.abc import Sequence

import numpy as np

from machine.description import Joint
from protocol.codes import FaultBit
from server.commissioning.contracts import Figure, ReportTable, StepResult, inconclusive_result, result_of_figures
from server.commissioning.moving import read_machine, wait_shown
from server.commissioning.site import Site
from server.link.contracts import PlcSample

JOINT_RANGES_STEP_NAME = "joint ranges"
JOINT_RANGES_REMEDY = "check wiring, zero and sign of the encoders named, and the ranges in the machine file"
REST_WATCH_DURATION_S = 2.0
REST_SPREAD_MAX_DEG = 0.05  # spread of a resting encoder: 36 counts of 18 bit
END_TOLERANCE_DEG = 1.0  # the mechanical end may lie this far inside the file's range
ENCODER_FAULT_BITS = FaultBit.SENSOR | FaultBit.JOINT_RANGE


async def joint_ranges(site: Site) -> StepResult:
    """Watch the encoders at rest, and ask for the ends where the engineer wants that."""
    before = site.link.latest
    await wait_shown(site, REST_WATCH_DURATION_S, "watching the encoders at rest")
    samples = site.link.samples_since(0)
    recent = [s for s in samples if before is None or s.t_mono_ns > before.t_mono_ns]
    if len(recent) < 10:
        return inconclusive_result(
            JOINT_RANGES_STEP_NAME,
            f"{len(recent)} states in {REST_WATCH_DURATION_S:.0f} s",
            "fix the link first (step 1)",
        )
    figures = range_figures(recent, site.machine.joints)
    if not site.options.ask_for_ends:
        note = "the mechanical end stops were not checked; --ends includes them"
        return result_of_figures(
            JOINT_RANGES_STEP_NAME,
            figures,
            "all joints quiet and inside their ranges",
            JOINT_RANGES_REMEDY,
            notes=(note,),
        )
    ends, not_driven, table = await _measure_range_ends(site)
    summary = "all joints quiet, inside their ranges, and the ranges inside the mechanical ends"
    return result_of_figures(
        JOINT_RANGES_STEP_NAME, [*figures, *ends], summary, JOINT_RANGES_REMEDY, not_driven, tables=(table,)
    )


def range_figures(samples: Sequence[PlcSample], joints: Sequence[Joint]) -> list[Figure]:
    """Quietness, place in the range, and sensor faults."""
    qs = np.rad2deg(np.array([sample.q_rad for sample in samples]))
    figures = []
    for joint, column in zip(joints, qs.T, strict=True):
        low, high = math.degrees(joint.q_min_rad), math.degrees(joint.q_max_rad)
        figures += [
            Figure(f"{joint.name}: angle", float(np.median(column)), "deg", low, high),
            Figure(f"{joint.name}: spread at rest", float(np.ptp(column)), "deg", at_most=REST_SPREAD_MAX_DEG),
        ]
    faults = int(samples[-1].fault_bits) & int(ENCODER_FAULT_BITS)
    return [*figures, Figure("faults SENSOR or JOINT_RANGE", float(faults.bit_count()), "of 2", at_most=0.0)]


async def _measure_range_ends(site: Site) -> tuple[list[Figure], list[str], ReportTable]:
    """Every joint by lever to both ends; the engineer says when it is there."""
    figures: list[Figure] = []
    not_driven: list[str] = []
    rows: list[tuple[str, ...]] = []
    for index, joint in enumerate(site.machine.joints):
        for side, limit_rad in (("lower", joint.q_min_rad), ("upper", joint.q_max_rad)):
            key = f"joint_ranges.{joint.name}_{side}"
            answer = await site.operator.ask(
                key,
                f"{joint.name} to its {side} end by lever, then Enter (or the encoder's angle there [deg]; s: skip)",
            )
            if answer is None or answer.strip().lower() == "s":
                not_driven.append(f"{joint.name}: {side} end not driven to")
                continue
            q_deg, limit_deg = await _angle_deg(answer, site, index), math.degrees(limit_rad)
            figures.append(end_figure(joint.name, side, q_deg, limit_deg))
            rows.append((joint.name, side, f"{q_deg:.2f}", f"{limit_deg:.2f}"))
    return figures, not_driven, ReportTable("mechanical ends", ("joint", "end", "encoder deg", "file deg"), tuple(rows))


async def _angle_deg(answer: str, site: Site, index: int) -> float:
    """The typed angle, or the encoder's present one."""
    try:
        return float(answer)
    except ValueError:
        return math.degrees((await read_machine(site)).q_rad[index])


def end_figure(name: str, side: str, q_deg: float, limit_deg: float) -> Figure:
    """How far the mechanical end lies inside the file's range; negative: outside of it, as it should be."""
    inside = q_deg - limit_deg if side == "lower" else limit_deg - q_deg
    return Figure(f"{name}: {side} end inside the file's range by", inside, "deg", at_most=END_TOLERANCE_DEG)
