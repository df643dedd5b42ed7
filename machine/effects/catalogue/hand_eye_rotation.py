"""hand_eye_rotation: the camera is turned on its mount."""

from machine.effects.spec import Direction, Effect, Parameter, Prior

EFFECT = Effect(
    name="hand_eye_rotation",
    stage="camera",
    scope="machine",
    parameters=(
        Parameter(
            name="angle_rad",
            unit="rad",
            low=0.0,
            high=0.5,
            start=0.02,
            prior=Prior("half_normal", 0.04),
            meaning="of the camera on its mount, about the axis",
        ),
    ),
    direction=Direction("axis", (0.0, 1.0, 0.0), "cam_left"),
    looks_like="what is seen is turned about the camera; error in proportion to distance",
    distinguished_by=(
        "encoder_bias of the last joint is the same until that joint turns; principal_point_error for narrow views"
    ),
    source="mount tilt 3 to 5 deg in the field",
    prevalence=0.5,
)
