"""A harmonic oscillator with the thermostat of Nosé and Hoover: friction that follows the kinetic energy.

Hoover (Phys. Rev. A 31 (1985) 1695); Posch, Hoover and Vesely (Phys. Rev. A 33 (1986) 4253); case A of Sprott (Phys.
Rev. E 50 (1994) R647), whose exponents are 0.014, 0 and -0.014 at temperature 1 from p = 5. Reversible, and volume
is kept on the average alone.
"""


def system(temperature=1.0):
    def rhs(y, t):
        q, p, friction = y
        return p, -q - friction * p, p**2 - temperature

    return {"rhs": rhs, "coordinates": ("q", "p", "friction")}
