"""transport_delay: the reference reaches the PLC later than nominal."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="transport_delay",
    stage="link",
    scope="machine",
    parameters=(
        Parameter(
            name="delay_s",
            unit="s",
            low=0.0,
            high=0.5,
            start=0.02,
            prior=Prior("half_normal", 0.05),
            meaning="beyond the nominal transport delay",
        ),
    ),
    looks_like="the received reference is the sent one, shifted in time, whatever its shape",
    distinguished_by=(
        "valve_lag rounds steps off, a delay only shifts them; a constant error of the PLC-to-PC clock offset looks "
        "the same in one direction and needs a round trip"
    ),
    source=(
        "command latency is the first suspect of sim-to-real users; delays up to 0.7 s on an excavator (Egli and "
        "Hutter 2022)"
    ),
    prevalence=0.3,
)
