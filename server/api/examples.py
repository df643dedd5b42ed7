"""One example of every model of the document, by the model's name; checked against its own schema by a test.

They are one story: `crane-7` in the simulator, a positioning job of a fleet that is at its first move.
"""

from typing import Any

Example = dict[str, Any]

JOB_ID, PLAN_HASH, T_UNIX_S = "c56f0b3a41d7", "9f2c41d07ab35e68", 1795348800.25
# fmt: off
_ERROR = {
    "x_mm": -12.4, "y_mm": 8.1, "z_mm": 203.7, "rotation_deg": 1.3, "sigma_x_mm": 0.9, "sigma_y_mm": 0.8,
    "sigma_z_mm": 1.6, "sigma_rotation_deg": 0.2, "distance_mm": 204.2, "camera_x_mm": 10.9, "camera_y_mm": -7.7,
    "camera_z_mm": 303.1,
}
_AFTER = _ERROR | {"x_mm": 1.1, "y_mm": -0.6, "z_mm": 2.0, "rotation_deg": 0.4, "distance_mm": 2.4}
_EVENT = {
    "number": 3, "elapsed_s": 14.2, "name": "move", "current": 0.0, "target": 6.5, "unit": "s",
    "text": "move 1: 204 mm in 6.5 s",
}
_JOB = {
    "job_id": JOB_ID, "kind": "position", "owner": "fleet 1", "state": "running", "code": "", "reason": "",
    "elapsed_s": 14.9, "events": [_EVENT], "result": None,
}
_CONTROL = {
    "owner": "fleet 1", "kind": "fleet", "fencing": 12, "expires_in_s": 11.3, "stale": False, "asked_by": [],
    "offered_to": "",
}
_PATCH = {
    "target_id": 3, "status": "ok", "reason": "", "image": 1412, "u_px": 655.0, "v_px": 322.5, "distance_mm": 1184.2,
    "normal_deg": 1.6, "position_mm": 0.9, "radius_mm": 60.0, "shape": "plane", "oblique_deg": 11.4,
    "outline_px": [[681.0, 322.4], [655.1, 296.3], [629.2, 322.6], [655.0, 348.8]],
    "ellipse_px": [[656.1, 322.5], [655.0, 321.4], [653.9, 322.5], [655.0, 323.6]],
    "axes_px": [[655.0, 322.5], [677.4, 322.4], [655.1, 300.2], [651.3, 320.7]], "reach": "reachable",
    "reach_reason": "",
}
_MARK = {
    "number": 1, "diameter_mm": 50.7, "sigma_diameter_mm": 0.4, "nominal_mm": 51.0, "dark_inside": True,
    "patch": _PATCH,
}
_LINK = {
    "phase": "armed", "age_ms": 6.2, "lost_pct": 0.0, "round_trip_ms": 1.1, "plc_state": "RUN", "buffer_ms": 2950.0,
    "underruns": 0, "fault_bits": 0, "simulation": True, "dry_run": False, "last_reject": "", "recent_rejects": [],
    "lateness_p99_ms": 0.51, "warning": "",
}
_CAMERA = {"fps": 15.0, "age_ms": 41.0, "process_ms": 18.3, "skipped": 0, "warnings": []}
_MARKER = {
    "marker_id": 10, "corners_px": [[612.1, 301.4], [668.0, 302.2], [667.3, 358.9], [611.6, 357.8]],
    "residual_px": 0.12, "used": True, "reason": "",
}
_LOOK = {"status": "ok", "reason": "", "error": _ERROR, "n_used": 20, "spread_mm": 0.31, "age_s": 8.4}
_CALIBRATION = {
    "method": "trajectory matching", "status": "ok", "reason": "", "sigma_deg": 0.21, "from_nominal_deg": 2.7,
    "time_offset_ms": 43.5, "residual_rms_mm": 1.4, "n_used": 247, "observability": 0.31, "duration_s": 16.5,
    "focal_off_pct": 0.11, "focal_sigma_pct": 0.28, "valid": True, "expiry_reason": "", "age_s": 31.0,
    "made_unix_s": T_UNIX_S - 31.0, "sigmas_deg": [0.09, 0.11, 0.15], "observability_text": "all three axes",
    "path_length_m": 1.9, "radius_mm": 1000.0, "distance_mm": 120.0, "age_max_h": 12.0, "map_looks": 2,
}
_PLAN = {
    "plan_hash": PLAN_HASH, "expires_in_s": 58.1, "length_mm": 204.2, "duration_s": 6.5, "tcp_speed_max_mm_s": 60.0,
    "clearance_mm": 96.4, "sigma_min": 0.41, "joint_travel_deg": [1.2, 3.8, -2.9, 0.4, 1.1, 0.2],
    "predicted_sigma_mm": [1.2, 1.1, 1.9], "caution": "", "before": _ERROR,
    "path_base_m": [[3.105, 0.412, 1.208], [3.301, 0.406, 1.211]],
    "q_goal_rad": [0.131, 0.698, -1.413, 0.087, -0.71, 0.052],
}
_MOVE = {
    "number": 1, "kind": "move", "before": _ERROR, "after": _AFTER, "predicted_sigma_mm": [1.2, 1.1, 1.9],
    "length_mm": 204.2, "duration_s": 6.5, "trims": 1, "t_rest_plc_ns": 81_250_000_000,
}
_LEASE = {
    "lease_id": "4hT2mB0qk1Xx7Zy9cVbN3aQw", "fencing": 12, "owner": "fleet 1", "kind": "fleet", "ttl_s": 15.0,
    "expires_in_s": 15.0,
}
_STATE = {
    "version": "0.1.0", "mode": "SIM", "machine": "hiab033",
    "joint_names": ["slew", "lift", "tilt", "yaw", "pitch", "roll"], "q_deg": [7.5, 40.0, -80.9, 5.0, -40.7, 3.0],
    "q_ref_deg": [7.5, 40.1, -80.9, 5.0, -40.7, 3.0], "q_min_deg": [-180.0, -10.0, -150.0, -90.0, -120.0, -180.0],
    "q_max_deg": [180.0, 80.0, -5.0, 90.0, 60.0, 180.0], "link": _LINK, "camera": _CAMERA, "markers": [_MARKER],
    "live_error": None, "look": _LOOK, "calibration": _CALIBRATION, "calibration_note": "", "plan": _PLAN,
    "moves": [_MOVE], "job": _JOB, "tolerance_mm": 5.0, "tolerance_deg": 1.0, "stand_off_mm": 100.0,
    "control": _CONTROL, "compensation": {"active": False, "effects": []},
    "steps": {"look": "position of fleet 1 is running", "stop": ""},
}

VERSION_ID = "5c1e0d7a92b4"
_FOUND: Example = {
    "name": "gravity_sag", "joint": 2, "parameters": {"compliance_rad_nm": 1.1e-06}, "tool_mm": 26.1,
    "probability": 0.99, "does": "kinematics", "on": True,
}
_VERSION: Example = {
    "version_id": VERSION_ID, "made_unix_s": T_UNIX_S - 86400.0, "machine": "hiab033", "serial": "7",
    "recordings": ["20261129T102045-identify-91f66b75d4ab.mcap"], "diagnosis_id": "0a1b2c3d4e5f",
    "sentence": "The model misses the tool by 41 mm. With the 9 confirmed effects it misses by 3.1 mm.",
    "miss_mm": 41.0, "left_mm": 3.1, "effects": [_FOUND],
}
_COMPARED: Example = {"number": 1, "nominal_mm": 14.2, "in_use_mm": 2.9, "version_id": VERSION_ID}

EXAMPLES: dict[str, Example] = {
    "AskRequest": {"owner": "anna"},
    "AuditView": {
        "number": 381, "t_unix_s": T_UNIX_S, "who": "fleet program", "role": "fleet", "address": "192.168.7.20",
        "action": "job.position", "outcome": "accepted", "lease_owner": "fleet 1", "fencing": 12,
        "request_id": "7b0e2d4c", "idempotency_key": "b7c1a3f0-3c52-4c0e-9f0e-8f1f6f1f0a11", "plan_hash": "",
        "job_id": JOB_ID, "detail": "",
    },
    "CalibrateRequest": {"kind": "calibrate"},
    "CalibrationEntry": {
        "number": 5, "made_unix_s": T_UNIX_S - 31.0, "job_id": JOB_ID, "method": "trajectory matching",
        "sigma_deg": 0.21, "residual_rms_mm": 1.4, "view": {"status": "ok", "sigma_deg": 0.21},
    },
    "CalibrationView": _CALIBRATION,
    "CameraView": _CAMERA,
    "CompensationView": {"active": True, "effects": ["backlash of joint 2"]},
    "ControlView": _CONTROL,
    "DiagnosisView": {
        "diagnosis_id": "0a1b2c3d4e5f", "recording": "20261121T052553-position-6c4a5f3859a3.mcap",
        "recordings": ["20261121T052553-position-6c4a5f3859a3.mcap", "20261121T054107-identify-c56f0b3a41d7.mcap"],
        "job_id": JOB_ID, "state": "running", "reason": "",
        "last_line": "searching actuator 2: 37 % done, 20 to 60 s left", "elapsed_s": 21.4,
    },
    "ErrorView": _ERROR,
    "ExecuteRequest": {"kind": "execute", "plan_hash": PLAN_HASH},
    "FaultView": {
        "fault_id": "camera_silent", "level": "URGENT", "text": "no new image for 3.2 s",
        "hint": "check the camera and its cable",
    },
    "GoalRequest": {"stand_off_mm": 100.0, "offset_x_mm": 0.0, "offset_y_mm": -20.0},
    "GoalView": {"stand_off_mm": 100.0, "offset_x_mm": 0.0, "offset_y_mm": -20.0},
    "GrantRequest": {"to": "anna"},
    "HealthView": {"status": "ok"},
    "JobEventView": _EVENT,
    "JobView": _JOB,
    "ComparedView": _COMPARED,
    "FoundEffectView": _FOUND,
    "IdentificationView": {
        "parts_done": ["repeats", "slow passes"], "parts_left": ["multisine", "looks"],
        "recordings": ["20261129T102045-identify-91f66b75d4ab.mcap"], "diagnosis_id": "",
        "next_step": "paused after 'hold-to-run: button up': 2 of 4 parts are left (multisine, looks); plan the rest",
    },
    "InUse": {"version_id": VERSION_ID, "on": [True]},
    "NewVersion": {"diagnosis_id": "0a1b2c3d4e5f"},
    "VersionView": _VERSION,
    "VersionsView": {"in_use": VERSION_ID, "problem": "", "versions": [_VERSION], "compared": [_COMPARED]},
    "LeaseRequest": {"owner": "fleet 1", "kind": "fleet", "ttl_s": 15.0},
    "JogRequest": {"kind": "jog", "axis": "joint_2", "direction": 1},
    "LeaseView": _LEASE,
    "LineRequest": {"kind": "line", "variant": "fit"},
    "LinkView": _LINK,
    "LookEntry": {
        "number": 2, "t_unix_s": T_UNIX_S - 8.4, "job_id": JOB_ID, "status": "ok", "reason": "", "error": _ERROR,
        "n_used": 20,
    },
    "LookRequest": {"kind": "look", "owner": "anna"},
    "LookView": _LOOK,
    "MarkerViewOut": _MARKER,
    "MoveView": _MOVE,
    "OrientRequest": {"kind": "orient"},
    "ParkRequest": {"kind": "park", "wall_free": False},
    "PathDiagnosis": {"path": "imported/crane-7.mcap"},
    "PlanEntry": {
        "plan_hash": PLAN_HASH, "job_id": JOB_ID, "made_unix_s": T_UNIX_S - 2.0, "expires_unix_s": T_UNIX_S + 58.0,
        "expired": False, "view": {"plan_hash": PLAN_HASH, "length_mm": 204.2},
    },
    "PlanIdentifyRequest": {"kind": "plan_identify", "minutes": 6.0, "wall_free": False, "resume": False},
    "IdentifyRequest": {"kind": "identify", "plan_hash": PLAN_HASH},
    "PlanView": _PLAN,
    "PatternRequest": {"kind": "pattern", "target_ids": [3, 4, 5]},
    "PositionRequest": {"kind": "position", "method": "ours", "recalibrate": True},
    "PreviewRequest": {"kind": "preview"},
    "Problem": {
        "type": "about:blank", "title": "Busy", "status": 409,
        "detail": f'position of fleet 1 (job {JOB_ID}) is running', "code": "busy",
        "hint": "wait for its end, or POST /v1/stop", "references": {"job_id": JOB_ID, "owner": "fleet 1"},
    },
    "ReadyView": {"ready": False, "reasons": ["the camera delivers no images: check its cable and [camera] settings"]},
    "RecordingView": {
        "name": "20261121T052553-position-6c4a5f3859a3.mcap", "size_mb": 93.7, "unix_s": T_UNIX_S - 900.0,
    },
    "RetractRequest": {"kind": "retract", "distance_mm": 300.0},
    "ReturnRequest": {"kind": "return"},
    "RunsDiagnosis": {"run_ids": ["20261121T052553-position-6c4a5f3859a3", "20261121T054107-identify-c56f0b3a41d7"]},
    "RunDiagnosis": {"run_id": "20261121T052553-position-6c4a5f3859a3"},
    "RunView": {
        "run_id": "20261121T052553-position-6c4a5f3859a3", "bytes": 93_710_034, "changed_unix_s": T_UNIX_S - 900.0,
    },
    "ServoRequest": {"kind": "servo"},
    "SettingRow": {"name": "position.tolerance_mm", "value": "5.0", "unit": "mm"},
    "StateView": _STATE,
    "ObjectsView": {"names": ["bolt-plate"], "in_use": "", "view_landmarks": [231, 204]},
    "TargetRequest": {"target_id": 3},
    "FindMarksRequest": {"image": 1412, "diameters_mm": [51.0, 64.0]},
    "MarksView": {"image": 1412, "reason": "", "marks": [_MARK]},
    "MarkView": _MARK,
    "TeachRequest": {"name": "bolt-plate"},
    "TeachViewRequest": {"image": 1412, "centre_mm": [550.0, 100.0, 0.0], "size_mm": [480.0, 380.0, 140.0]},
    "MeasureTargetRequest": {"image": 1412, "u_px": 655.0, "v_px": 322.5, "roll_deg": 0.0},
    "PatchView": _PATCH,
    "TargetView": {"target": _PATCH, "candidate": None, "image": 1420},
    "TakeRequest": {"owner": "anna", "kind": "operator", "reason": "the hose has come off", "ttl_s": 15.0},
    "TimeView": {"t_unix_ns": 1_795_348_800_250_000_000, "t_mono_ns": 81_251_003_117, "life": "3fa9c01b"},
    "WhoView": {"name": "anna", "role": "operator"},
}

FREE_FORM: dict[str, Example] = {
    "GET /v1/diagnoses/{diagnosis_id}/result": {
        "format_version": 2, "verdict": "effects", "why": "confirmed effects explain 97 % of it",
        "budget": {
            "sentence": "The model misses the tool by 7.1 mm. With the 1 confirmed effects it misses by 1.2 mm.",
            "miss_mm": 7.1, "left_mm": 1.2,
            "effects": [
                {
                    "name": "valve_lag", "joint": 2, "stage": "actuator",
                    "parameters": {
                        "time_constant_s": {"value": 0.0296517, "unit": "s", "low": 0.0290358, "high": 0.0302959},
                    },
                    "column": "gets_there", "tool_mm": 7.0, "probability": 0.98, "status": "confirmed",
                    "used": {"time_constant_s": {"value": 0.0296517, "unit": "s"}},
                },
            ],
        },
        "indistinguishable": [],
        "missing": [
            {
                "signal": "nothing was measured behind the encoders",
                "costs": "nothing was measured behind the encoders: no camera, no tracker",
            },
        ],
    },
}
# fmt: on


def with_examples(document: dict[str, Any]) -> None:
    """Put them into an OpenAPI document: models by name, answers of free form by their operation."""
    for name, schema in document["components"]["schemas"].items():
        if name in EXAMPLES:
            schema["examples"] = [EXAMPLES[name]]
    for operation, example in FREE_FORM.items():
        method, _, path = operation.partition(" ")
        content = document["paths"][path][method.lower()]["responses"]["200"]["content"]
        content["application/json"]["example"] = example
