"""encoder_scale: the encoder counts too many or too few per turn."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="encoder_scale",
    stage="joint",
    scope="joint",
    parameters=(
        Parameter(
            name="scale_frac",
            unit="1",
            low=-0.1,
            high=0.1,
            start=0.01,
            prior=Prior("normal", 0.01),
            meaning="encoder = true (1 + scale_frac)",
        ),
    ),
    looks_like="a joint error in proportion to the joint's angle",
    distinguished_by="encoder_bias is constant; needs the joint's whole range, measured from outside",
    source="wrong gear ratio or linear sensor calibration",
    prevalence=0.05,
)
