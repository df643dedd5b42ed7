"""Faults of the arm's shape, as the generator injects them and as the catalogue states them: both bend it alike."""

from benchmarks.diagnosis.sealed.faults import Injected

ARM_EFFECTS = (
    (Injected("link_length_error", 2, {"error_m": 0.01}, "a"), {"error_m": 0.01, "of": "a"}),
    (Injected("link_length_error", 3, {"error_m": 0.01}, "d"), {"error_m": 0.01, "of": "d"}),
    (Injected("joint_axis_tilt", 2, {"tilt_rad": 0.01}, "y"), {"tilt_rad": 0.01, "about": "y"}),
    (Injected("gravity_sag", 3, {"compliance_rad_nm": 1e-6}), {"compliance_rad_nm": 1e-6}),
    (Injected("base_tilt", None, {"tilt_rad": 0.1}, "", (0.6, 0.8, 0.0)), {"tilt_rad": 0.1, "axis": [0.6, 0.8, 0]}),
    (Injected("base_compliance", None, {"compliance_rad_nm": 1e-6}), {"compliance_rad_nm": 1e-6}),
)  # fmt: skip
