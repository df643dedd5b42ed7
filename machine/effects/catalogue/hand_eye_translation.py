"""hand_eye_translation: the camera is displaced from its nominal place."""

from machine.effects.spec import Direction, Effect, Parameter, Prior

EFFECT = Effect(
    name="hand_eye_translation",
    stage="camera",
    scope="machine",
    parameters=(
        Parameter(
            name="distance_m",
            unit="m",
            low=0.0,
            high=0.5,
            start=0.01,
            prior=Prior("half_normal", 0.015),
            meaning="of the camera from its nominal place, along the direction",
        ),
    ),
    direction=Direction("direction", (1.0, 0.0, 0.0), "tcp"),
    looks_like="a constant offset in the camera's frame, whatever the distance; seen only when the wrist turns",
    distinguished_by=(
        "hand_eye_rotation grows with distance; link_length_error of the last link is the same direction until the "
        "wrist turns"
    ),
    source="mounts measured by ruler: 10 mm",
    prevalence=0.5,
)
