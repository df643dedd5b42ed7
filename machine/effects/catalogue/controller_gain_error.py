"""controller_gain_error: the controller's gain is not the one in the machine file."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="controller_gain_error",
    stage="controller",
    scope="joint",
    parameters=(
        Parameter(
            name="gain_frac",
            unit="1",
            low=-0.6,
            high=1.0,
            start=0.15,
            prior=Prior("normal", 0.15),
            meaning="kp times (1 + gain_frac)",
        ),
    ),
    looks_like="valve command over tracking error has another slope, at every speed",
    distinguished_by="flow_gain_error shows behind the valve command; controller_lag_error changes fast parts only",
    source="contract of the gap diagnosis",
)
