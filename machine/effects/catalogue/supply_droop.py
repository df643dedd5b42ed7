"""supply_droop: the pump cannot serve all joints together."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="supply_droop",
    stage="actuator",
    scope="machine",
    parameters=(
        Parameter(
            name="flow_limit_frac",
            unit="1",
            low=0.05,
            high=6.0,
            start=0.8,
            prior=Prior("log_uniform"),
            meaning="sum over the joints of |qd| / velocity_gain that the pump can give",
            neutral=float("inf"),
        ),
    ),
    looks_like="joints slow down together once their summed flow exceeds a limit",
    distinguished_by="flow_gain_error and load_droop act on one joint alone; needs several joints moving together",
    source="pump sharing of open-centre and load-sensing cranes: 60 l/min for all functions",
)
