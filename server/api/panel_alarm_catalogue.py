"""Every alarm: what, cause, what to do, who may clear it. The help pages and docs/alarms/ come from this table."""

from dataclasses import dataclass
from typing import Literal

Level = Literal["high", "medium", "low"]  # high: motion is impossible or has been stopped; low: an extra is missing


@dataclass(frozen=True, slots=True)
class AlarmKind:
    """One kind of alarm; texts are complete sentences for the operator."""

    code: str
    level: Level
    title: str
    cause: str
    remedy: str
    clears: str


CLEARED_BY_OPERATOR_TEXT = "the operator with control, by Acknowledge; it disappears once its cause is gone too"
CLEARED_AT_MACHINE_TEXT = (
    "a person at the machine removes the cause; then the operator with control presses Reset fault, then Acknowledge"
)

# fmt: off
_KINDS = (
    AlarmKind("plc_silent", "high", "The PLC does not answer",
        "No state received from the PLC for 250 ms: it is off, the network is down, or another PC is connected to it.",
        "Check the PLC's power, program and cable, the address in [plc], and that no other server controls it.",
        CLEARED_BY_OPERATOR_TEXT),
    AlarmKind("plc_estop", "high", "Emergency stop at the machine",
        "The PLC reports that its hard-wired emergency stop was pressed.",
        "Find out why. Release the button at the machine, then press Reset fault. This does not start a motion.",
        CLEARED_AT_MACHINE_TEXT),
    AlarmKind("plc_enable_lost", "high", "Local enable lost",
        "The enable at the machine was withdrawn while the machine was armed.",
        "Make sure that no one is near the machine, give the enable at the machine, then press Reset fault.",
        CLEARED_AT_MACHINE_TEXT),
    AlarmKind("plc_lag", "high", "A joint does not follow its reference",
        "Encoder and reference are too far apart: a blocked joint, low supply pressure, a stuck or disconnected valve.",
        "Look at the machine, the pump and the valve plugs before you press Reset fault. Retract before you try again.",
        CLEARED_AT_MACHINE_TEXT),
    AlarmKind("plc_joint_range", "high", "A joint is outside its range",
        "The PLC reads a joint angle beyond the limits of the machine file.",
        "Drive the joint back by the local lever, then press Reset fault. If it is inside, its encoder zero is wrong.",
        CLEARED_AT_MACHINE_TEXT),
    AlarmKind("plc_sensor", "high", "A sensor of the machine failed",
        "The PLC reports that an encoder or a pressure sensor delivers no values or impossible ones.",
        "Check plug and cable of the sensor that the PLC names, then press Reset fault.", CLEARED_AT_MACHINE_TEXT),
    AlarmKind("plc_pressure", "high", "Hydraulic pressure outside its limits",
        "The supply pressure is too low or too high.",
        "Check pump, oil level and relief valve, then press Reset fault.", CLEARED_AT_MACHINE_TEXT),
    AlarmKind("plc_oil_temperature", "high", "Oil temperature outside its limits",
        "The oil is too cold to control precisely, or too hot for the seals.",
        "Let it warm up without load, or cool down; then press Reset fault and calibrate again.",
        CLEARED_AT_MACHINE_TEXT),
    AlarmKind("plc_program", "high", "The PLC program reports a fault",
        "Its cycle took too long or differs from the machine file, or its message layout is of another version.",
        "Have the PLC engineer compare the versions and look at the task's execution time, then press Reset fault.",
        CLEARED_AT_MACHINE_TEXT),
    AlarmKind("link_lossy", "medium", "The PLC link loses many datagrams",
        "More than 5 % of the states of the last ten seconds did not arrive.",
        "Use a dedicated cable between PC and PLC; see the lateness histogram under Engineering, Link.",
        CLEARED_BY_OPERATOR_TEXT),
    AlarmKind("plc_contested", "medium", "Another PC addresses the PLC",
        "Two servers address one PLC, which takes commands of one session only: the text gives its number.",
        "Stop one of the two servers, or set another PLC in its [plc]. The server that has the session keeps working.",
        CLEARED_BY_OPERATOR_TEXT),
    AlarmKind("camera_silent", "high", "No image from the camera",
        "No new image for one second: the camera is off, its cable is loose, or its computer is overloaded.",
        "Check the camera's power and cable and [camera] in the settings. A look is not possible until it is back.",
        CLEARED_BY_OPERATOR_TEXT),
    AlarmKind("camera_unfit", "medium", "The images are not usable for measurement",
        "Images arrive, but the checks found them frozen, blurred, dark, swapped or damaged: the text states which.",
        "Follow this alarm's detail: clean the lens, light the target, reseat the cable. Looks are refused until then.",
        CLEARED_BY_OPERATOR_TEXT),
    AlarmKind("vision_ended", "medium", "The vision process has ended",
        "The program that finds the markers ended unexpectedly. It is being started again.",
        "Wait for ten seconds. If the alarm returns each time, note the text and read the server's log.",
        CLEARED_BY_OPERATOR_TEXT),
    AlarmKind("keys_unreadable", "high", "The key file cannot be read",
        "The file with the keys changed and cannot be read any more, or is missing: no key and no session is valid.",
        "Make it readable to the server's user, or write it again with `longreach keys`. Then log in again.",
        CLEARED_BY_OPERATOR_TEXT),
    AlarmKind("server_part_failed", "high", "A part of the server failed",
        "One of the server's permanent loops ended with an error. If it was the lease guard, the job was stopped.",
        "It restarts automatically. Report what the server's log says; restart the server if the alarm returns.",
        CLEARED_BY_OPERATOR_TEXT),
    AlarmKind("store_failed", "high", "The database cannot be written",
        "The database in the recordings folder cannot be written, so no job may start and no one can take control.",
        "Free space, or make the folder writable; move a damaged database away by hand. The server retries.",
        CLEARED_BY_OPERATOR_TEXT),
    AlarmKind("recording_failed", "medium", "The run is not being recorded",
        "The file of the recording could not be written: full disk, missing folder, or no permission.",
        "Free space in the recordings' folder. Jobs go on without a recording.", CLEARED_BY_OPERATOR_TEXT),
    AlarmKind("disk_low", "medium", "The disk is nearly full", "Less than 1 GB is left where recordings are written.",
        "Move old recordings away (Engineering, Recordings).", CLEARED_BY_OPERATOR_TEXT),
    AlarmKind("calibration_expired", "medium", "The local calibration is not valid here",
        "It is too old, the machine is too far from where it was made, or something slipped: the text states which.",
        "Press Calibrate.", CLEARED_BY_OPERATOR_TEXT),
    AlarmKind("job_failed", "medium", "A job ended without reaching its goal", "The text states the job's reason.",
        "Follow this alarm's detail, the job's reason, then start again with Look.", CLEARED_BY_OPERATOR_TEXT),
    AlarmKind("hold_lost", "medium", "Hold-to-run was lost",
        "The page that held the button was silent for more than 250 ms: a stalled network, browser or computer.",
        "The machine was ramped to a stop. Check the network, then preview again and hold again.",
        CLEARED_BY_OPERATOR_TEXT),
    AlarmKind("mode_mismatch", "medium", "Settings and PLC disagree: SIM or REAL",
        "Every PLC state reports whether it drives a simulation; the mode in the settings differs.",
        "Until they agree, every motion requires hold-to-run, as on a real machine. Set mode in the settings file.",
        CLEARED_BY_OPERATOR_TEXT),
    AlarmKind("scene_ended", "low", "The 3D view is not running",
        "The program that draws the 3D view has ended. It sends no commands; everything else works.",
        "Nothing: it restarts automatically. If it does not, read the server's log.", CLEARED_BY_OPERATOR_TEXT),
)
# fmt: on
CATALOGUE: dict[str, AlarmKind] = {kind.code: kind for kind in _KINDS}


def page_markdown(kind: AlarmKind) -> str:
    """The help page of one alarm, as it stands in docs/alarms/."""
    return (
        f"# {kind.title}\n\n`{kind.code}`, priority {kind.level}\n\n"
        f"**Cause.** {kind.cause}\n\n**What to do.** {kind.remedy}\n\n**Who may clear it:** {kind.clears}.\n\n"
        "Acknowledging an alarm or resetting a fault never starts a motion.\n"
    )


def index_markdown() -> str:
    """docs/alarms.md: one row an alarm."""
    rows = [
        f"| [{kind.title}](alarms/{kind.code}.md) | `{kind.code}` | {kind.level} | {kind.remedy} |" for kind in _KINDS
    ]
    return "\n".join(
        [
            "# Alarms",
            "",
            "An alarm is latched: it stays until it is acknowledged and its cause is gone.",
            "Acknowledging never restarts motion.",
            "Generated from `server/api/panel_alarm_catalogue.py`; a test compares it.",
            "",
            "| Alarm | Code | Priority | What to do |",
            "|---|---|---|---|",
            *rows,
            "",
        ]
    )
