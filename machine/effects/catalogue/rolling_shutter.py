"""rolling_shutter: rows are exposed one after another."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="rolling_shutter",
    stage="camera",
    scope="machine",
    parameters=(
        Parameter(
            name="readout_s",
            unit="s",
            low=-0.05,
            high=0.05,
            start=0.01,
            prior=Prior("half_normal", 0.011),
            meaning="from the first row's exposure to the last's",
        ),
        Parameter(
            name="stamp_row",
            unit="1",
            low=-1.0,
            high=1.0,
            start=0.0,
            prior=Prior("uniform"),
            meaning="what the stamp states: 0 the middle row's exposure, 1 the first row's, -1 the last row's",
            role="shape",
            integer=True,
        ),
    ),
    looks_like="while moving, the upper half of the image trails the lower or leads it: markers shear",
    distinguished_by="camera_latency shifts all rows alike",
    source="11 ms readout of CMOS stereo cameras",
    prevalence=0.05,
)
