"""Step: every joint moves in the commanded direction, by its encoder and in the eyes of the engineer."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machine.chain import Chain
from machine.kinematics import link_poses, tcp_jacobian, tcp_pose
from machine.rotations import Array
from protocol.codes import FaultBit
from server.commissioning.contracts import Figure, ReportTable, StepResult, Verdict, result_of_figures
from server.commissioning.moving import (
    NoLeaveError,
    NotReadyError,
    PlayedMotion,
    arm_if_needed,
    gentle_plan,
    play_gently,
    require_leave,
    wait_for_rest,
)
from server.commissioning.site import Site
from server.link.contracts import PlcSample
from server.link.errors import LinkError

JOINT_SIGNS_STEP_NAME = "joint signs"
JOINT_SIGNS_REMEDY = (
    "stop here: reverse the valve's wires or gain where the valve opened the wrong way, the encoder's sign where the "
    "tool went the wrong way, then run this step again"
)
STEP_MIN_RAD, STEP_MAX_RAD = math.radians(2.0), math.radians(6.0)
TEST_TIP_TRAVEL_M = 0.03  # a wrist turns as much as moves the tip by this, so that it can be seen
RUNAWAY_ANGLE_MAX_RAD = math.radians(1.0)  # the wrong way by this much: valves to neutral immediately
FOLLOWED_MIN, FOLLOWED_MAX = 0.3, 1.5  # of the step; a dead band swallows a part
PRESSURE_MAX_PA = 50e6
_REMARK = "the direction of the tool was not entered"


# Which way the tool goes when a joint turns, as seen by a person behind the machine. Pure.
#
# Seen by a person at the column who looks outward along the boom: out and in along the boom's horizontal direction,
# left and right across it, up and down. A joint that only turns the tool is identified by its turn, looking the way
# the tool looks.

OPPOSITE_DIRECTION_WORDS = {"out": "in", "left": "right", "up": "down", "clockwise": "counter-clockwise"}
_OPPOSITE = OPPOSITE_DIRECTION_WORDS | {value: key for key, value in OPPOSITE_DIRECTION_WORDS.items()}
_SHORT = {"cw": "clockwise", "ccw": "counter-clockwise", "l": "left", "r": "right", "u": "up", "d": "down"}
_VISIBLE_M = 0.008  # a smaller motion of the tip is not seen from the column
_SIDE_SHARE = 0.5  # of the largest component: a person may name this one as well


@dataclass(frozen=True, slots=True)
class ExpectedDirection:
    """What a person should see: the words that are right, the largest first, and a sentence for the report."""

    accepted_words: tuple[str, ...]
    text: str


def person_axes(T_base_tcp: Array) -> Array:
    """Axes of the person behind the machine in base (3, 3): rows: out, left, up; out is x above the column."""
    across = T_base_tcp[:2, 3]
    length = float(np.linalg.norm(across))
    out = np.array([across[0] / length, across[1] / length, 0.0]) if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    return np.array([out, np.cross(up, out), up])


def expected_motion(chain: Chain, q: Array, joint: int, step_rad: float) -> ExpectedDirection:
    """What the tool does when one joint turns by a step, by the machine's geometry.

    Args:    q: joints now (n,) [rad]; joint: index; step_rad: signed [rad].
    """
    after = q.copy()
    after[joint] += step_rad
    T_before, T_after = tcp_pose(chain, q), tcp_pose(chain, after)
    seen = person_axes(T_before) @ (T_after[:3, 3] - T_before[:3, 3])
    if float(np.abs(seen).max()) < _VISIBLE_M:
        return _expected_tool_turn(chain, q, joint, step_rad, T_before)
    names = (("out", "in"), ("left", "right"), ("up", "down"))
    order = np.argsort(-np.abs(seen))
    large = [i for i in order if abs(seen[i]) >= _SIDE_SHARE * abs(seen[order[0]])]
    words = tuple(names[i][0 if seen[i] > 0.0 else 1] for i in large)
    millimetres = ", ".join(f"{1e3 * abs(seen[i]):.0f} mm {names[i][0 if seen[i] > 0.0 else 1]}" for i in large)
    return ExpectedDirection(words, f"tool tip goes {millimetres}")


def _expected_tool_turn(chain: Chain, q: Array, joint: int, step_rad: float, T_base_tcp: Array) -> ExpectedDirection:
    axis = link_poses(chain, q)[joint][:3, 2] * np.sign(step_rad)
    looking = -T_base_tcp[:3, 2]  # the tool looks along -z_tcp
    word = "clockwise" if float(axis @ looking) > 0.0 else "counter-clockwise"
    turn = f"{abs(np.rad2deg(step_rad)):.1f} deg"
    return ExpectedDirection((word,), f"tool turns {turn} {word}, seen from behind it, looking the way it looks")


def parse_direction(answer: str) -> str | None:
    """The word that a person meant, or None."""
    word = answer.strip().lower()
    word = _SHORT.get(word, word)
    return word if word in _OPPOSITE else None


def is_expected_direction(expected: ExpectedDirection, word: str) -> bool | None:
    """Whether a seen word fits: True, False (it is the opposite of one), or None: neither."""
    if word in expected.accepted_words:
        return True
    return False if any(_OPPOSITE[right] == word for right in expected.accepted_words) else None


@dataclass(frozen=True, slots=True)
class SignTestJog:
    """One joint's small motion, as the states show it."""

    joint_name: str
    step_rad: float
    followed_frac: float  # share of the step that the encoder made, signed
    valve_frac: float  # mean valve command while the reference moved, positive: the way of the step
    pressures_ok: bool
    objection: str
    reached: bool


async def joint_signs(site: Site) -> StepResult:
    """Jog every joint by 2 to 6 deg, slowly, and ask which way the tool went."""
    figures: list[Figure] = []
    not_jogged: list[str] = []
    rows: list[tuple[str, ...]] = []
    for index, joint in enumerate(site.machine.joints):
        try:
            await require_leave(site, f"{joint.name} will now be jogged slowly; keep the emergency stop in hand")
            jog, expected, answer = await _one_joint(site, index)
        except NoLeaveError as error:
            if not figures:
                raise
            not_jogged.append(f"{joint.name}: {error}")  # what was measured so far is kept
            break
        except (NotReadyError, LinkError) as error:  # here, too
            not_jogged.append(f"{joint.name}: {error}")
            break
        figures += jog_figures(jog)
        seen, seen_figure = seen_as(jog.joint_name, expected, answer)
        figures += seen_figure
        not_jogged += [] if seen_figure else [f"{joint.name}: {seen}"]
        step = f"{math.degrees(jog.step_rad):+.1f}"
        rows.append(
            (joint.name, step, expected.text, seen, f"{100 * jog.followed_frac:.0f}", f"{100 * jog.valve_frac:+.1f}")
        )
        if jog.objection or not jog.reached or not all(figure.ok for figure in seen_figure):
            break  # a joint that goes the wrong way ends this step: the others wait for the remedy
    headings = ("joint", "step deg", "expected", "seen", "followed %", "valve %")
    table = ReportTable("jogs", headings, tuple(rows))
    return _with_skip(
        result_of_figures(
            JOINT_SIGNS_STEP_NAME,
            figures,
            "every joint moves in the commanded direction",
            JOINT_SIGNS_REMEDY,
            not_jogged,
            tables=(table,),
        )
    )


def _with_skip(result: StepResult) -> StepResult:
    """What was measured stands, and what was not seen stays open: never a silent pass."""
    if result.verdict is not Verdict.INCONCLUSIVE:
        return result
    return StepResult(
        result.name,
        result.verdict,
        f"measured values are correct; still open: {result.summary}",
        result.figures,
        "watch the tool and answer, or give the answers in --answers; remove what else is named",
        result.notes,
        result.tables,
    )


async def _one_joint(site: Site, index: int) -> tuple[SignTestJog, ExpectedDirection, str | None]:
    await arm_if_needed(site)
    start = await wait_for_rest(site)
    joint = site.machine.joints[index]
    step = jog_step(site, start.q_rad, index)
    expected = expected_motion(site.chain, start.q_rad, index, step)
    goal = start.q_ref.copy()
    goal[index] += step
    played = await play_gently(
        site, goal, f"jogging {joint.name}", lambda sample: why_end_jog(sample, start.q_rad, index, step)
    )
    jog = jog_of(joint.name, played, start.q_rad, index, step)
    if jog.objection or not jog.reached:
        return jog, expected, None
    jog = replace(jog, followed_frac=float((await wait_for_rest(site)).q_rad[index] - start.q_rad[index]) / step)
    question = (
        f"{joint.name}: which way did the tool go, seen from behind the machine? "
        "[left, right, up, down, out, in, cw, ccw (looking the way the tool looks); empty: not seen]"
    )
    answer = await _ask_direction(site, f"joint_signs.{joint.name}", question)
    await play_gently(site, start.q_ref, f"{joint.name} back")
    return jog, expected, answer


async def _ask_direction(site: Site, key: str, question: str) -> str | None:
    for _ in range(3):
        answer = await site.operator.ask(key, question)
        if answer is None or not answer.strip():
            return None
        word = parse_direction(answer)
        if word is not None:
            return word
        site.operator.show(f"'{answer}' is not one of the directions")
    return None


def jog_step(site: Site, q: Array, index: int) -> float:
    """A step that can be seen, to the side where there is room [rad]. Raises: NotReadyError: room on neither side."""
    lever_m = float(np.linalg.norm(tcp_jacobian(site.chain, q)[:3, index]))
    size = min(max(STEP_MIN_RAD, TEST_TIP_TRAVEL_M / max(lever_m, 1e-6)), STEP_MAX_RAD)
    for step in (size, -size):
        goal = q.copy()
        goal[index] += step
        if gentle_plan(site, q, goal).trajectory is not None:
            return step
    name = site.machine.joints[index].name
    raise NotReadyError(f"{name} has no room for {math.degrees(size):.1f} deg to either side; move it from its end")


def why_end_jog(sample: PlcSample, q_start: Array, index: int, step: float) -> str:
    """Why the jog must end now: the joint went the wrong way, or another joint moved as well; empty: all is well."""
    moved = np.array(sample.q_rad) - q_start
    backwards = -moved[index] * math.copysign(1.0, step)
    if backwards > RUNAWAY_ANGLE_MAX_RAD:
        return f"went {math.degrees(backwards):.1f} deg the wrong way"
    if abs(moved[index]) > abs(step) + 2.0 * RUNAWAY_ANGLE_MAX_RAD:
        return f"went {math.degrees(abs(moved[index])):.1f} deg, {math.degrees(abs(step)):.1f} deg were commanded"
    others = np.delete(np.abs(moved), index)
    if len(others) and float(others.max()) > RUNAWAY_ANGLE_MAX_RAD:
        return f"another joint moved by {math.degrees(float(others.max())):.1f} deg: crossed valves or encoders"
    return ""


def jog_of(name: str, played: PlayedMotion, q_start: Array, index: int, step: float) -> SignTestJog:
    """What the states of one jog say."""
    samples = played.plc_samples
    moving = [s for s in samples if abs(s.qd_ref_rad_s[index]) > 1e-3]
    valve = float(np.mean([s.valve_frac[index] for s in moving])) * math.copysign(1.0, step) if moving else math.nan
    moved = samples[-1].q_rad[index] - q_start[index] if samples else math.nan
    reason = played.objection or ("" if played.motion_end.reached else played.motion_end.reason)
    faults = FaultBit(samples[-1].fault_bits) if samples else FaultBit(0)
    if reason and faults:
        reason = f"{reason}; faults {faults!s}"
    return SignTestJog(
        name, step, moved / step, valve, pressures_plausible(samples, index), reason, played.motion_end.reached
    )


def pressures_plausible(samples: Sequence[PlcSample], index: int) -> bool:
    """Whether both chambers always read between nothing and 500 bar."""
    values = [p for sample in samples for p in (sample.pressure_a_pa[index], sample.pressure_b_pa[index])]
    return all(-1e5 <= value <= PRESSURE_MAX_PA for value in values)


def jog_figures(jog: SignTestJog) -> list[Figure]:
    """Encoder, valve and pressures of one jog against what they should be."""
    ended = (
        f"{jog.joint_name}: jog ended early ({jog.objection})"
        if jog.objection
        else f"{jog.joint_name}: jog ended early"
    )
    return [
        Figure(ended, 0.0 if jog.reached and not jog.objection else 1.0, "times", at_most=0.0),
        Figure(f"{jog.joint_name}: encoder followed", jog.followed_frac, "of the step", FOLLOWED_MIN, FOLLOWED_MAX),
        Figure(f"{jog.joint_name}: valve opened the step's way", jog.valve_frac, "of full", at_least=1e-6),
        Figure(
            f"{jog.joint_name}: chamber pressures outside 0 .. 500 bar", float(not jog.pressures_ok), "times", None, 0.0
        ),
    ]


def seen_as(name: str, expected: ExpectedDirection, word: str | None) -> tuple[str, list[Figure]]:
    """What was seen in words, and a figure for it; no figure when the answer does not give one."""
    if word is None:
        return _REMARK, []
    fits = is_expected_direction(expected, word)
    if fits is None:
        return f"'{word}' was seen, {' or '.join(expected.accepted_words)} was expected: watch again", []
    figure = Figure(f"{name}: tool seen to go the wrong way ({word})", float(not fits), "times", at_most=0.0)
    return word, [figure]
