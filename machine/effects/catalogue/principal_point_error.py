"""principal_point_error: the optical centre deviates from the calibration."""

from machine.effects.spec import Direction, Effect, Parameter, Prior

EFFECT = Effect(
    name="principal_point_error",
    stage="camera",
    scope="machine",
    parameters=(
        Parameter(
            name="shift_px",
            unit="px",
            low=0.0,
            high=60.0,
            start=3.0,
            prior=Prior("half_normal", 3.0),
            meaning="of the principal point along the direction (u right, v down)",
        ),
    ),
    direction=Direction("direction", (1.0, 0.0), "image"),
    looks_like="the whole image is shifted, the same at every distance",
    distinguished_by=(
        "hand_eye_rotation is nearly the same for narrow views, but bends perspective; hand_eye_translation falls "
        "with distance"
    ),
    source="1 px left after a good calibration",
)
