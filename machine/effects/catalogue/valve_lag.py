"""valve_lag: the valve opens later than the nominal second-order spool."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="valve_lag",
    stage="actuator",
    scope="joint",
    parameters=(
        Parameter(
            name="time_constant_s",
            unit="s",
            low=0.0,
            high=0.5,
            start=0.05,
            prior=Prior("half_normal", 0.05),
            meaning="of a first-order lag ahead of the nominal valve",
            open_size=2.5e-3,  # a quarter of a PLC cycle: when within it the command took effect is not logged
        ),
    ),
    looks_like="speed follows the command rounded off; steady speeds agree",
    distinguished_by=(
        "transport_delay shifts without rounding and shows before the valve command; needs steps, not slow sines"
    ),
    source="pilot stages of proportional valves, 20 to 100 ms",
)
