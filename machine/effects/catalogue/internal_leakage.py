"""internal_leakage: oil leaks across the piston and the load sinks."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="internal_leakage",
    stage="actuator",
    scope="joint",
    parameters=(
        Parameter(
            name="drift_rad_s",
            unit="rad/s",
            low=-0.05,
            high=0.05,
            start=0.003,
            prior=Prior("half_normal", 0.003),
            meaning="drift along gravity at the joint's reference load",
        ),
    ),
    looks_like="slow drift along gravity's pull, also at zero command; grows with the load",
    distinguished_by="valve_asymmetry needs a command; encoder_bias is constant; needs a hold under load of a minute",
    source="piston seal leakage; cylinder drift tests of crane standards",
)
