"""What belongs together when something is added: each test names the places that were missed (docs/how-to/)."""

import re
from pathlib import Path
from typing import get_args

import pytest

from benchmarks.diagnosis.sealed.scales import BY_NAME, NOT_JUDGED
from machine.effects.layout import slots_of
from machine.effects.registry import EFFECTS, effect_of
from server.access.roles import COMMANDING_ROLES, roles_needed
from server.api.examples import EXAMPLES
from server.api.hold_rule import MOTIONLESS_JOB_KINDS
from server.api.panel_alarm_catalogue import CATALOGUE
from server.compensation.effects import COMPENSATION_TEXT_BY_EFFECT
from server.jobs.service import JobBody, JobService
from server.settings_camera import CameraSettings
from sim_plc.diagnosed import CHANGES
from tests.unit.sim_plc.command_side import NAMES as SIMULATED_COMMAND_SIDE

ROOT = Path(__file__).parents[2]
#: Effects that the simulator's plant does not have: stated here, or simulated.
NOT_SIMULATED = set(
    [
        "base_compliance",
        "base_tilt",
        "clock_drift",
        "encoder_eccentricity",
        "encoder_scale",
        "internal_leakage",
        "joint_axis_tilt",
        "joint_friction",
        "link_flexibility",
        "load_droop",
        "odometry_scale",
        "oil_compliance",
        "packet_loss",
        "payload_error",
        "reference_quantisation",
        "reference_rate_limit",
        "stereo_misalignment",
        "stiction",
        "supply_droop",
    ]
)
#: Effects of a diagnosed machine file that the server does nothing about: stated here, or compensated.
NOT_COMPENSATED = set(
    [
        "camera_latency",
        "clock_drift",
        "clock_offset",
        "controller_gain_error",
        "controller_lag_error",
        "controller_saturation",
        "flow_gain_error",
        "focal_length_error",
        "internal_leakage",
        "joint_friction",
        "lens_distortion",
        "link_flexibility",
        "load_droop",
        "marker_size_error",
        "odometry_scale",
        "oil_compliance",
        "packet_loss",
        "principal_point_error",
        "reference_quantisation",
        "reference_rate_limit",
        "rolling_shutter",
        "stereo_misalignment",
        "stiction",
        "supply_droop",
        "tool_marker_rotation",
        "tool_marker_translation",
        "valve_asymmetry",
        "valve_hysteresis",
        "valve_lag",
    ]
)
JOBS = {get_args(body.model_fields["kind"].annotation)[0]: body for body in get_args(JobBody)}
WITHOUT_BUTTON = {"servo", "pattern", "line"}  # over REST only
OWN_HOLD = {"jog", "identify"}  # their buttons are held by scripts of their own
SOURCES = {get_args(kind.model_fields["kind"].annotation)[0]: kind for kind in get_args(get_args(CameraSettings)[0])}


def text_of(*names: str) -> str:
    return "".join((ROOT / name).read_text(encoding="utf-8") for name in names)


def missed(**places: bool) -> str:
    return "; ".join(place.replace("__", " ") for place, there in places.items() if not there)


def has_columns(name: str) -> bool:
    try:
        return bool(slots_of(name, None if effect_of(name).scope == "machine" else 1))
    except KeyError:
        return False


@pytest.mark.parametrize("name", [effect.name for effect in EFFECTS])
def test_an_effect_is_whole(name):
    simulated = name in CHANGES or name in SIMULATED_COMMAND_SIDE
    places = {
        "columns in machine/effects/layout.py": has_columns(name),
        "a row in docs/effects.md": name in text_of("docs/effects.md"),
        "sim_plc/diagnosed.py, command_side.py of tests/unit/sim_plc, or NOT_SIMULATED here": (
            simulated != (name in NOT_SIMULATED)
        ),
        "server/compensation/effects.py, or NOT_COMPENSATED here": (name in COMPENSATION_TEXT_BY_EFFECT)
        != (name in NOT_COMPENSATED),
        "KINDS or NOT_JUDGED in benchmarks/diagnosis/sealed/scales.py": (name in BY_NAME) != (name in NOT_JUDGED),
    }
    assert missed(**places) == "", f"effect {name} is missing in: {missed(**places)}"


@pytest.mark.parametrize("kind", SOURCES)
def test_a_camera_source_is_whole(kind):
    section = SOURCES[kind].__name__
    source = section.removesuffix("CameraSettings") + "Source"
    places = {
        f"a dataclass {source} in server/camera/sources/settings.py": f"class {source}:"
        in text_of("server/camera/sources/settings.py"),
        f"a case {section} in server/settings_source.py": f"case {section}()" in text_of("server/settings_source.py"),
        f"a case {source} in server/camera/sources/opening.py": f"case {source}()"
        in text_of("server/camera/sources/opening.py"),
        "the list of kinds in docs/vision.md": f"`{kind}`" in text_of("docs/vision.md"),
        "what --source means in longreach/camera_command.py": section in text_of("longreach/camera_command.py"),
        "tests/unit/camera/test_camera_settings.py": f'kind = "{kind}"'
        in text_of("tests/unit/camera/test_camera_settings.py"),
    }
    assert missed(**places) == "", f"camera source {kind} is missing in: {missed(**places)}"


@pytest.mark.parametrize("kind", JOBS)
def test_a_job_is_whole(kind):
    name = JOBS[kind].__name__
    scripts = text_of(*(str(path.relative_to(ROOT)) for path in (ROOT / "web" / "static").glob("*.js")))
    steps = "".join(re.findall(r"^const (?:MAIN|MINOR) = .*$", text_of("web/static/steps.js"), re.MULTILINE))
    moves = next(line for line in text_of("web/static/steps.js").splitlines() if line.startswith("const MOVES"))
    places = {
        "a case in server/jobs/service.py": name in JobService._plan.__code__.co_names
        or f"case {name}()" in text_of("server/jobs/service.py"),
        "an example in server/api/examples.py": name in EXAMPLES,
        "a button in web/static, or WITHOUT_BUTTON here": (f'"{kind}"' in steps or f'kind: "{kind}"' in scripts)
        != (kind in WITHOUT_BUTTON),
        "MOVES in web/static/steps.js (what moves is held on REAL), or STILL in server/api/hold_rule.py": (
            kind in MOTIONLESS_JOB_KINDS | WITHOUT_BUTTON | OWN_HOLD or f'"{kind}"' in moves
        ),
    }
    assert missed(**places) == "", f"job {kind} is missing in: {missed(**places)}"
    assert roles_needed("POST", "/v1/jobs") == COMMANDING_ROLES


@pytest.mark.parametrize("code", CATALOGUE)
def test_an_alarm_is_whole(code):
    raisers = (
        "server/api/panel_alarms.py",
        "server/api/panel_memory.py",
        "server/api/hold.py",
        "server/inner_faults.py",
    )
    places = {
        f"docs/alarms/{code}.md": (ROOT / "docs" / "alarms" / f"{code}.md").is_file(),
        "a line in docs/alarms.md": f"{code}.md" in text_of("docs/alarms.md"),
        f"something that raises it ({', '.join(raisers)})": f'"{code}"' in text_of(*raisers),
    }
    assert missed(**places) == "", f"alarm {code} is missing in: {missed(**places)}"
