"""flow_gain_error: the joint is faster or slower than nominal at the same command."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="flow_gain_error",
    stage="actuator",
    scope="joint",
    parameters=(
        Parameter(
            name="gain_frac",
            unit="1",
            low=-0.6,
            high=0.6,
            start=0.12,
            prior=Prior("normal", 0.1),
            meaning="flow gain of both signs times (1 + gain_frac)",
        ),
    ),
    looks_like="speed over command has another slope, both signs, every load",
    distinguished_by=(
        "load_droop changes with the load: another posture or payload shows it; supply_droop only shows while other "
        "joints move"
    ),
    source="valve size and supply pressure tolerance; oil temperature",
    prevalence=0.3,
)
