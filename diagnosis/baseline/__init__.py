"""A machine's baseline, fitted on recordings without a fault: effects, forms, what searches find there."""
