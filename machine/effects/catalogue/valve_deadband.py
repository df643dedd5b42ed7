"""valve_deadband: the spool must leave its overlap before oil flows."""

from machine.effects.spec import Choice, Effect, Parameter, Prior

EFFECT = Effect(
    name="valve_deadband",
    stage="actuator",
    scope="joint",
    parameters=(
        Parameter(
            name="half_width_frac",
            unit="1",
            low=0.0,
            high=0.25,
            most=0.7,
            start=0.04,
            prior=Prior("half_normal", 0.04),
            meaning="spool opening, of full command, within which no oil flows",
            open_frac=0.05,  # where a rounded edge of the spool begins, and what friction takes of small openings
        ),
    ),
    choice=Choice("full_flow", ("kept", "lost"), "whether a full command still gives the full flow"),
    looks_like="no motion for small commands, either sign; the joint stops short of its target",
    distinguished_by=(
        "valve_hysteresis depends on the direction of change, stiction on whether the joint moves already, "
        "flow_gain_error acts on large commands too; needs slow passes through zero"
    ),
    source=(
        "+-10 % of the half range on the PATU 655 (u_dl, u_dh of its public parameters); servo valves 2 %; up to "
        "two thirds on cheap mobile valves, whose spool no controller holds"
    ),
    prevalence=0.5,
    threshold=True,
)
