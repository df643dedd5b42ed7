"""backlash: the link lags its encoder by the gear's play."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="backlash",
    stage="joint",
    scope="joint",
    parameters=(
        Parameter(
            name="width_rad",
            unit="rad",
            low=0.0,
            high=0.05,
            start=0.003,
            prior=Prior("half_normal", 0.002),
            meaning="peak to peak, behind the encoder",
        ),
    ),
    looks_like=(
        "after each reversal the link stands still while the encoder moves; two values of the link for one encoder "
        "angle"
    ),
    distinguished_by=(
        "gravity_sag is the same from both sides; valve_hysteresis shows in the encoder; needs approaches from both "
        "sides"
    ),
    source="slew rack and pinion +-0.75 mrad, helical wrist actuators 0.05 to 0.5 deg",
    threshold=True,
)
