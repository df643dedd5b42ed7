"""packet_loss: some datagrams never arrive and the PLC holds the last reference."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="packet_loss",
    stage="link",
    scope="machine",
    parameters=(
        Parameter(
            name="loss_frac",
            unit="1",
            low=0.0,
            high=0.5,
            start=0.05,
            prior=Prior("half_normal", 0.05),
            meaning="share of the reference's datagrams that never arrive; the last one is held",
        ),
    ),
    looks_like=(
        "single steps of the received reference are missing at random, in all joints together; skipped sequence numbers"
    ),
    distinguished_by="reference_quantisation depends on the value, not on time; transport_delay shifts every sample",
    source="UDP link without repeats",
    prevalence=0.1,
    threshold=True,
)
