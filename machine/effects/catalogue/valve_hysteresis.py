"""valve_hysteresis: the spool follows the command with play."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="valve_hysteresis",
    stage="actuator",
    scope="joint",
    parameters=(
        Parameter(
            name="half_width_frac",
            unit="1",
            low=0.0,
            high=0.1,
            most=0.3,
            start=0.015,
            prior=Prior("half_normal", 0.01),
            meaning="half width of the play between command and spool, of full command",
            open_size=2e-4,  # a step of the command that an encoder of 18 bits makes
        ),
    ),
    looks_like="speed depends on whether the command rises or falls; a lag that does not vanish at slow motion",
    distinguished_by=(
        "backlash shows behind the encoder; valve_deadband is the same for rising and falling commands; needs "
        "reversals of small and of large commands"
    ),
    source="magnetic and friction hysteresis of proportional solenoids, 0.5 to 5 %",
    prevalence=0.3,
    threshold=True,
)
