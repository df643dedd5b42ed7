"""Every time limit of the link in one table, each with its reason; docs/plc-link.md prints it, a test compares."""

from dataclasses import dataclass

MS = 1_000_000  # nanoseconds


@dataclass(frozen=True, slots=True)
class Timeout:
    """One time limit: who watches it, how long, what happens then and why this long.

    Enforced by `plc_link.py` (PLC) and `client_link.py` (PC), in their `poll`.
    """

    name: str
    watched_by: str
    duration_ns: int
    action: str
    reason: str


# fmt: off
COMMAND_PERIOD = Timeout("command period", "PC", 20 * MS, "next command is sent",
    "50 Hz: ten may be lost within the 300 ms of knots in one command")
HELLO_PERIOD = Timeout("hello period", "PC", 100 * MS, "HELLO again",
    "quick to connect, 10 datagrams a second while waiting")
ARM_PERIOD = Timeout("arm period", "PC", 100 * MS, "ARM or RESET again",
    "heartbeats in between keep the session while it is refused")
STATE_PERIOD = Timeout("state period", "PLC", 10 * MS, "next state is sent", "the PLC's log cycle")
COMMAND_LATE_TIMEOUT = Timeout("command late", "PLC", 100 * MS, "warning LINK_LATE",
    "five commands missing: visible before it hurts")
COMMAND_LOST_TIMEOUT = Timeout("command lost", "PLC", 250 * MS, "RUN -> STOPPING -> HOLD",
    "shorter than the 300 ms of knots: the ramp starts on the path")
SESSION_TIMEOUT = Timeout("session void", "PLC", 1000 * MS, "HOLD, LINKED -> DISARMED",
    "a restarted PC gets in again after a second; motion needs ARM")
ECHO_STALE_TIMEOUT = Timeout("echo stale", "PLC", 250 * MS, "command refused, RUN -> STOPPING",
    "a PC that does not see the machine must not move it")
STATE_LATE_TIMEOUT = Timeout("state late", "PC", 100 * MS, "no new knots, heartbeats only", "ten states missing")
STATE_LOST_TIMEOUT = Timeout("state lost", "PC", 250 * MS, "STOP is sent, link counts as offline",
    "same bound as the PLC's")
SERVO_STALE_TIMEOUT = Timeout("servo target stale", "PC, PLC", 60 * MS, "target stands still",
    "three commands: a target may move on for this long without news of it")
SERVO_LOST_TIMEOUT = Timeout("servo target lost", "PC", 250 * MS, "STOP is sent",
    "the steering client is gone: same bound as for commands")
LINK_CLOSE_TIMEOUT = Timeout("link closed", "PC", 1000 * MS, "session given up, HELLO with a new one",
    "same bound as the PLC's")
TRAJECTORY_START_TIMEOUT = Timeout("start wait", "PC", 1000 * MS, "trajectory counts as not started, STOP is sent",
    "fifty commands unanswered")
EXIT_STOP_TIMEOUT = Timeout("stop on exit", "PC", 500 * MS, "process ends",
    "a ramp takes less; the PLC's watchdog follows anyway")

ALL_TIMEOUTS = (
    COMMAND_PERIOD, HELLO_PERIOD, ARM_PERIOD, STATE_PERIOD, COMMAND_LATE_TIMEOUT, COMMAND_LOST_TIMEOUT,
        SESSION_TIMEOUT, ECHO_STALE_TIMEOUT,
    STATE_LATE_TIMEOUT, STATE_LOST_TIMEOUT, SERVO_STALE_TIMEOUT, SERVO_LOST_TIMEOUT, LINK_CLOSE_TIMEOUT,
        TRAJECTORY_START_TIMEOUT, EXIT_STOP_TIMEOUT,
)
# fmt: on

GOOD_COMMANDS_TO_ARM = 25  # half a second of a working link before the machine may be armed
SEQUENCE_JUMP_MAX = 1000  # 20 s of commands: a larger step is not loss but another sender
KNOT_RING_CAPACITY = 64  # knots that the PLC can hold: 3.2 s at 50 ms
KNOT_SPACING_MIN_NS = 5 * MS
KNOT_SPACING_MAX_NS = 200 * MS
FROZEN_KNOT_LEAD_NS = 100 * MS  # knots nearer than this ahead of the playback are not replaced any more: five commands
PREFILL_NS = 800 * MS  # a motion starts with so much of it in the PLC: a hard start survives ten lost commands
TAIL_LEAD_NS = 200 * MS  # the PC asks for twice that, so that some commands may be lost
# A servo target is at most this long at full speed away from the reference: further is a mistake
SERVO_TARGET_LEAD_MAX_S = 0.25
PLAUSIBLE_SPEED_FACTOR = 1.5  # of qd_max: no joint is faster, so an encoder that says more while a ramp begins is wrong
START_TOLERANCE_RAD = 1e-5  # 0.05 mm at 5 m: rounding, not distance


def table_markdown() -> str:
    """The table for the documentation."""
    rows = [f"| {t.name} | {t.watched_by} | {t.duration_ns // MS} | {t.action} | {t.reason} |" for t in ALL_TIMEOUTS]
    return "\n".join(["| Time limit | Watched by | ms | Then | Why |", "|---|---|---|---|---|", *rows])
