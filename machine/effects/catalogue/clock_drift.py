"""clock_drift: the camera's clock runs at another rate."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="clock_drift",
    stage="time",
    scope="machine",
    parameters=(
        Parameter(
            name="rate_ppm",
            unit="ppm",
            low=-500.0,
            high=500.0,
            start=50.0,
            prior=Prior("normal", 50.0),
            meaning="the camera's clock runs fast by this share, from the recording's start",
        ),
    ),
    looks_like="an offset between camera and encoders that grows evenly with time",
    told_apart_by="clock_offset is constant; needs motion early and late in the recording",
    source="crystal oscillators: 20 to 100 ppm",
)
