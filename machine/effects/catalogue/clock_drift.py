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
            low=-1000.0,
            high=1000.0,
            start=50.0,
            prior=Prior("normal", 50.0),
            meaning="the camera's clock runs fast by this share",
        ),
        Parameter(
            name="zero_s",
            unit="s",
            low=-60.0,
            high=60.0,
            start=0.0,
            prior=Prior("uniform"),
            meaning="when both clocks were right, after the recording's start",
            role="shape",
        ),
    ),
    looks_like="an offset between camera and encoders that grows evenly with time",
    distinguished_by="clock_offset is constant; needs motion early and late in the recording",
    source="crystal oscillators: 20 to 100 ppm",
    prevalence=0.02,
)
