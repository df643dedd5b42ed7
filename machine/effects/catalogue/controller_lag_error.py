"""controller_lag_error: the controller's PT-1 filter has another time constant."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="controller_lag_error",
    stage="controller",
    scope="joint",
    parameters=(
        Parameter(
            name="lag_frac",
            unit="1",
            low=-0.9,
            high=3.0,
            start=0.3,
            prior=Prior("normal", 0.3),
            meaning="PT-1 constant times (1 + lag_frac); only on joints that have one",
        ),
    ),
    looks_like="valve command follows the tracking error later or sooner; slow parts agree",
    distinguished_by="controller_gain_error changes slow parts too; valve_lag acts behind the logged command",
    source="contract of the gap diagnosis",
)
