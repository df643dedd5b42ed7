"""focal_length_error: the lens is longer or shorter than calibrated."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="focal_length_error",
    stage="camera",
    scope="machine",
    parameters=(
        Parameter(
            name="scale_frac",
            unit="1",
            low=-0.1,
            high=0.1,
            start=0.01,
            prior=Prior("normal", 0.01),
            meaning="true focal length over the nominal one, less 1",
        ),
    ),
    looks_like="everything appears larger or smaller by one factor",
    distinguished_by=(
        "marker_size_error scales distances only: the same at one distance, apart at two with known motion; "
        "odometry_scale leaves markers alone"
    ),
    source="0.15 % left after a good calibration",
)
