"""encoder_bias: the encoder's zero is off."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="encoder_bias",
    stage="joint",
    scope="joint",
    parameters=(
        Parameter(
            name="bias_rad",
            unit="rad",
            low=-0.3,
            high=0.3,
            start=0.01,
            prior=Prior("normal", 0.01),
            meaning="encoder = true + bias_rad",
        ),
    ),
    looks_like="a constant joint error: the tip errs along one direction that turns with the arm",
    distinguished_by=(
        "gravity_sag changes with posture; hand_eye_rotation turns with the wrist only; encoder_scale grows with the "
        "angle"
    ),
    source="joint zeros sd 0.25 deg after commissioning",
    prevalence=0.5,
)
