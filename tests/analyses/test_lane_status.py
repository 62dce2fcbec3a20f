"""Every analysis says the same of why a lane has failed."""

import numpy as np
import pytest

import jaxnh
from jaxnh.systems.status import NO_RETURN, NOT_FINITE


def hopf(mu=1.0, cubic=-1.0):
    """r' = mu r + cubic r^3, turning once in 2 pi: to the cycle of radius sqrt(mu), to rest, or to infinity."""

    def rhs(y, t):
        x, z = y
        growth = mu + cubic * (x * x + z * z)
        return growth * x - z, growth * z + x

    return {"rhs": rhs, "coordinates": ("x", "z")}


@pytest.fixture
def session():
    return jaxnh.Session(hopf, start={"x": 0.6, "z": 0.0}, target=1e-4).on("x", 0.5, "up", longest_return=20.0)


@pytest.mark.parametrize(
    "options",
    [
        jaxnh.Diagram(transient=8, strobes=4),
        jaxnh.Period(transient=8, max_period=2),
        jaxnh.Orbits(transient=8, max_period=1),
    ],
)
def test_why_lanes_fail(session, options):
    """A spiral into rest meets the section no more; r = 0.6 is infinite after log(0.36/0.16)/0.4 = 2.03."""
    found = session.run(options, mu=[-0.2, 1.0], cubic=[-1.0, 1.0])
    status = found["status"].transpose("mu", "cubic").to_numpy()
    np.testing.assert_array_equal(status, [[NO_RETURN, NOT_FINITE], [0, NOT_FINITE]])
    assert "rodas5p" not in repr(session)  # what goes to infinity before it returns is not stiff


def test_where_every_lane_goes_to_infinity(session):
    with pytest.raises(jaxnh.AccuracyError, match=r"goes to infinity at t = 2\.03$"):
        session.run("diagram", jaxnh.Diagram(transient=1, strobes=1), mu=-0.2, cubic=1.0)
