"""stiction: a resting joint sticks until the command is large enough, then jumps."""

from machine.effects.spec import Choice, Effect, Parameter, Prior

EFFECT = Effect(
    name="stiction",
    stage="actuator",
    scope="joint",
    parameters=(
        Parameter(
            name="breakaway_frac",
            unit="1",
            low=0.0,
            high=0.25,
            start=0.04,
            prior=Prior("half_normal", 0.03),
            meaning="command, of full, that a resting joint needs before it moves",
            open_frac=0.05,  # of joints that stick again below a tenth: 1 to 4.5 %
        ),
    ),
    choice=Choice("sticks_again", ("below_a_fifth", "at_reversals"), "where a moving joint sticks again"),
    looks_like="starts late and with a jump; runs on below the command that it needed to start",
    distinguished_by=(
        "valve_deadband also stops the joint early and starts it softly; valve_hysteresis needs no standstill"
    ),
    source="LuGre and Stribeck friction: static 300 N, Coulomb 210 N on the PATU 655's cylinders",
    prevalence=0.05,
    threshold=True,
)
