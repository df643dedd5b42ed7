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
            meaning="from the first row's exposure to the last's; stamps at mid-frame",
        ),
    ),
    looks_like="while moving, the upper half of the image trails the lower or leads it: markers shear",
    told_apart_by="camera_latency shifts all rows alike",
    source="11 ms readout of CMOS stereo cameras",
)
