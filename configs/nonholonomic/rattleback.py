"""A rattleback: an ellipsoid that rolls without slipping, its axes of inertia turned against those of its surface.

Sizes and moments are those of Kane and Levinson (Int. J. Non-Linear Mech. 17 (1982) 175), in metres and kilograms.
"""

from jaxnh.mechanics import ellipsoid, rolling_body


def system(mass=1.0, product=-0.2e-4, gravity=9.81):  # of inertia, between the long axis and the middle one
    inertia = (2e-4, product, 0.0), (product, 16e-4, 0.0), (0.0, 0.0, 17e-4)
    surface = ellipsoid((0.2, 0.03, 0.02), center=(0.0, 0.0, 0.01))
    return rolling_body(surface, mass, inertia, gravity)
