"""odometry_scale: visual odometry measures paths too long or too short."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="odometry_scale",
    stage="camera",
    scope="machine",
    parameters=(
        Parameter(
            name="scale_frac",
            unit="1",
            low=-0.3,
            high=0.3,
            start=0.02,
            prior=Prior("normal", 0.02),
            meaning="odometry's translation times (1 + scale_frac)",
        ),
    ),
    looks_like="odometry's translations are off by one factor, rotations are right",
    distinguished_by="focal_length_error also changes marker poses and rotations",
    source="0.3 % with a stereo baseline; free with one eye",
)
