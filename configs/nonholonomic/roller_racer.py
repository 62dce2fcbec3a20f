"""A roller racer: two platforms on wheels, joined at a pivot, that a periodic torque there drives against friction.

Krishnaprasad and Tsakiris (Dyn. Syst. 16 (2001) 347), Bizyaev, Borisov and Mamaev (Regul. Chaotic Dyn. 23 (2018) 983).
Wheels do not slide across. The equations are derived from T and Q; the parameters are not those of an article.
"""

import jax.numpy as jnp


def system(
    mass=1.0, inertia=0.3, ahead=0.2, pivot=0.4, front_mass=0.6, front_inertia=0.1, reach=1.0,
    torque=1.0, stiffness=1.0, damping=0.1, joint_damping=0.1, omega=1.0,
):  # fmt: skip
    def rates(q, u, t):
        c, s = jnp.cos(q[2]), jnp.sin(q[2])
        return u[0] * c - u[1] * s, u[0] * s + u[1] * c, u[2], u[3]

    def front(q, u):  # velocity of the middle of the front axle, along the front platform and across it
        c, s, side = jnp.cos(q[3]), jnp.sin(q[3]), u[1] + pivot * u[2]
        return u[0] * c + side * s, -u[0] * s + side * c + reach * (u[2] + u[3])

    def T(q, u, t):
        along, across, turn, steer = u
        rear = mass * (along**2 + (across + ahead * turn) ** 2) + inertia * turn**2
        forth, aside = front(q, u)
        return 0.5 * (rear + front_mass * (forth**2 + aside**2) + front_inertia * (turn + steer) ** 2)

    def Q(
        q, u, t
    ):  # friction of both pairs of wheels along their platforms; a spring, friction and torque at the pivot
        c, s, drag = jnp.cos(q[3]), jnp.sin(q[3]), -damping * front(q, u)[0]
        joint = torque * jnp.sin(omega * t) - stiffness * q[3] - joint_damping * u[3]
        return -damping * u[0] + drag * c, drag * s, drag * pivot * s, joint

    def f(q, u, t):
        return u[1], front(q, u)[1]

    names = {"coordinates": ("x", "y", "theta", "phi"), "angles": ("theta", "phi"), "ignorable": ("x", "y", "theta")}
    quasi = {"quasi_velocities": ("along", "across", "turn", "steer"), "dependent": ("across", "turn")}
    return {"T": T, "Q": Q, "f": f, "rates": rates, "period": 2 * jnp.pi / omega, **quasi, **names}
