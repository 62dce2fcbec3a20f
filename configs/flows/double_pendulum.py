"""The double pendulum of equal arms (Landau and Lifshitz, Mechanics, section 5), the lower weight `ratio` upper ones.

Lengths are arms, and times square roots of an arm over g. The energy is kept; at small angles the frequencies of the
two modes are w^2 = (1 + ratio) (1 +- sqrt(ratio / (1 + ratio))).
"""

import jax.numpy as jnp


def system(ratio=1.0):
    def T(q, v, t):
        both = ratio * v[0] * v[1] * jnp.cos(q[0] - q[1])
        return 0.5 * (1 + ratio) * v[0] ** 2 + both + 0.5 * ratio * v[1] ** 2

    def Q(q, v, t):
        return -(1 + ratio) * jnp.sin(q[0]), -ratio * jnp.sin(q[1])

    return {"T": T, "Q": Q, "coordinates": ("upper", "lower"), "angles": ("upper", "lower")}
