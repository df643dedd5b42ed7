"""stereo_misalignment: the right eye is turned against the left."""

from machine.effects.spec import Direction, Effect, Parameter, Prior

EFFECT = Effect(
    name="stereo_misalignment",
    stage="camera",
    scope="machine",
    parameters=(
        Parameter(
            name="angle_rad",
            unit="rad",
            low=0.0,
            high=0.1,
            start=0.003,
            prior=Prior("half_normal", 0.003),
            meaning="of the right eye against the left, about the axis",
        ),
    ),
    direction=Direction("axis", (0.0, 1.0, 0.0), "cam_right"),
    looks_like="rows disagree (about x), depth is off with its square (about y), or rows tilt (about z)",
    distinguished_by="focal_length_error scales depth evenly in both eyes; needs both eyes",
    source="rig drift after shocks; 0.1 px disparity bias",
)
