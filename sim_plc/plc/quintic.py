"""Quintic between two knots: position, velocity and acceleration agree with both."""

from dataclasses import dataclass

from protocol.messages import Knot

Vector = list[float]


@dataclass(frozen=True, slots=True)
class Quintic:
    """Coefficients of q(u) = c0 + c1 u + ... + c5 u^5 per axis, u in seconds from the first knot."""

    coefficients: tuple[tuple[float, float, float, float, float, float], ...]

    def at(self, u: float) -> tuple[Vector, Vector, Vector]:
        """Position, velocity and acceleration at u [s]."""
        q, qd, qdd = [], [], []
        for c0, c1, c2, c3, c4, c5 in self.coefficients:
            q.append(c0 + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5)))))
            qd.append(c1 + u * (2.0 * c2 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5))))
            qdd.append(2.0 * c2 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5)))
        return q, qd, qdd


def quintic_between(first: Knot, second: Knot, n: int) -> Quintic:
    """The quintic that joins two knots, for the first n axes."""
    h = (second.t_ns - first.t_ns) * 1e-9
    rows = []
    for i in range(n):
        step = second.q[i] - first.q[i] - first.qd[i] * h - 0.5 * first.qdd[i] * h * h
        speed = second.qd[i] - first.qd[i] - first.qdd[i] * h
        push = second.qdd[i] - first.qdd[i]
        c3 = (10.0 * step - 4.0 * speed * h + 0.5 * push * h * h) / h**3
        c4 = (-15.0 * step + 7.0 * speed * h - push * h * h) / h**4
        c5 = (6.0 * step - 3.0 * speed * h + 0.5 * push * h * h) / h**5
        rows.append((first.q[i], first.qd[i], 0.5 * first.qdd[i], c3, c4, c5))
    return Quintic(tuple(rows))
