"""Many recordings of many machines: each diagnosed on its own, then what they share and how it drifts."""
