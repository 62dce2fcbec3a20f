"""Covariant Lyapunov vectors: eigenvectors of linear maps, vectors that the map takes to each other, tangencies."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import jaxnh
from jaxnh.analyses.covariant.directions import settling_returns
from jaxnh.analyses.covariant.hyperbolicity import BOUNDED, SPLITS, TANGENT, judge_splits
from jaxnh.analyses.covariant.vectors import covariant_vectors, smallest_angles, volume_growth
from tests.flows import lorenz
from tests.flows.known_maps import henon
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.usefixtures("always_few_lanes")
GOLDEN = np.log((3.0 + np.sqrt(5.0)) / 2.0)


def words(data, name):
    return jaxnh.labels(data[name]).to_numpy().tolist()


def test_eigenvectors_of_a_matrix():
    """The vectors of a constant matrix are its eigenvectors, and their growth the logarithms of its eigenvalues."""
    basis = np.array([[1.0, 0.4, -0.3], [0.2, 1.0, 0.5], [0.1, -0.6, 1.0]])
    matrix = basis @ np.diag([2.5, 0.7, -0.1]) @ np.linalg.inv(basis)
    vectors = covariant_vectors(np.broadcast_to(matrix, (2, 200, 3, 3)), 60, 3)
    directions = (vectors.frames @ vectors.coefficients)[0, 40]
    cosines = np.abs(np.sum(directions * basis / np.linalg.norm(basis, axis=0), axis=0))
    assert cosines == pytest.approx(1.0, abs=1e-12)
    assert vectors.growth == pytest.approx(np.broadcast_to(np.log([2.5, 0.7, 0.1]), vectors.growth.shape), abs=1e-12)
    first, others = basis[:, 0] / np.linalg.norm(basis[:, 0]), np.linalg.qr(basis[:, 1:])[0]
    last, before = basis[:, 2] / np.linalg.norm(basis[:, 2]), np.linalg.qr(basis[:, :2])[0]
    exact = [np.arcsin(np.linalg.norm(v - b @ (b.T @ v))) for v, b in ((first, others), (last, before))]
    assert smallest_angles(vectors)[0, :, 40] == pytest.approx(exact, abs=1e-12)


def test_the_map_takes_vectors_to_each_other():
    """M_k v_k is along v_{k+1}, of random matrices."""
    matrices = np.random.default_rng(3).normal(size=(1, 300, 3, 3))
    vectors = covariant_vectors(matrices, 100, 3)
    every = (vectors.frames @ vectors.coefficients)[0]
    images = matrices[0, 100:199] @ every[:-1]
    lengths = np.linalg.norm(images, axis=1, keepdims=True)
    cosines = np.abs(np.sum(images / lengths * every[1:], axis=1))
    assert cosines == pytest.approx(1.0, abs=1e-9)
    assert np.log(lengths[:, 0]) == pytest.approx(vectors.growth[0, :-1], abs=1e-9)


def test_contraction_that_rounding_hides():
    """Maps that stretch by 2 and shrink by 1e-25 are of rank one in double precision; their volumes are not."""
    draw = np.random.default_rng(7)
    turns = np.linalg.qr(draw.normal(size=(2, 1, 300, 2, 2)))[0]
    matrices = turns[0] @ np.diag([2.0, 1e-25]) @ turns[1]
    growth = covariant_vectors(matrices, 100, 2).growth
    assert np.mean(growth.sum(axis=2)) > np.log(2e-25) + 1.0
    vectors = covariant_vectors(matrices, 100, 2, np.full((1, 300), 2e-25))
    change = np.log(np.abs(np.linalg.det(vectors.coefficients)))  # of the area between the vectors, of length one
    exact = np.log(2e-25) - np.diff(change, axis=1)
    assert vectors.growth.sum(axis=2)[:, :-1] == pytest.approx(exact, abs=1e-9)
    assert vectors.rounding.max() < 1e-6


def test_angles_with_and_without_a_tangency():
    """Even angles down to zero are those of a tangency, and even ones down to a bound are not; of few nothing is said."""
    even = np.random.default_rng(5).uniform(0.0, 1.0, (200, 1, 2048))
    assert np.mean(judge_splits(even) == TANGENT) > 0.95
    assert np.all(judge_splits(even + 0.2) == BOUNDED)
    assert np.all(judge_splits(even[..., :256]) == SPLITS.index("undecided"))


def cat():
    def image(y):
        x, z = y
        return jnp.stack([2.0 * x + z, x + z]) % (2.0 * jnp.pi)

    return {"map": image, "coordinates": ("x", "z"), "angles": ("x", "z")}


BASIS = np.array([[1.0, 0.4, -0.3], [0.2, 1.0, 0.5], [0.1, -0.6, 1.0]])
RATES = np.array([-0.06, -0.2, -0.5])


def linear_flow(drive=1.0):
    """Of the eigenvectors BASIS and eigenvalues RATES, under a drive that all motions come to move with."""
    matrix = BASIS @ np.diag(RATES) @ np.linalg.inv(BASIS)

    def rhs(y, t):
        force = drive * jnp.cos(2.0 * jnp.pi * t)
        return tuple(sum(entry * x for entry, x in zip(row.tolist(), y, strict=True)) + force for row in matrix)

    return {"rhs": rhs, "coordinates": ("x", "y", "z"), "period": 1.0}


def test_a_linear_flow():
    """Exponents are the eigenvalues, and angles those between eigenvectors: strobes rest, and sizes are one."""
    session = jaxnh.Session(linear_flow, start={"x": 1.0, "y": 0.3, "z": 0.2}, target=1e-9)
    data = session.run(jaxnh.Covariant(strobes=1024, transient=512))
    assert np.all(np.abs(data["exponents"] - RATES) <= data["exponents_error"])
    assert np.abs(data["exponents"] - RATES).max() < 1e-7  # an eighth of the points: vectors settle to e^(−0.14 · 128)
    assert words(data, "kind") == "regular"
    first, last = BASIS[:, 0] / np.linalg.norm(BASIS[:, 0]), BASIS[:, 2] / np.linalg.norm(BASIS[:, 2])
    planes = np.linalg.qr(BASIS[:, 1:])[0], np.linalg.qr(BASIS[:, :2])[0]
    exact = [np.arcsin(np.linalg.norm(v - b @ (b.T @ v))) for v, b in zip((first, last), planes, strict=True)]
    assert data["angle_median"].to_numpy() == pytest.approx(exact, abs=1e-6)


def suspended_cat(speed=0.3):
    """Points of a torus that the field moves to and fro, and Arnold's cat in the middle of each period."""

    def rhs(y, t):
        rate = speed * jnp.pi * jnp.sin(2.0 * jnp.pi * t)
        return rate, 0.5 * rate

    def cat_of(y, t):
        x, z = y[0] - speed, y[1] - 0.5 * speed
        turn = 2.0 * jnp.pi
        return (2.0 * x + z) % turn + speed, (x + z) % turn + 0.5 * speed

    def half(y, t):
        return -jnp.sin(2.0 * jnp.pi * t)

    return {
        "rhs": rhs,
        "coordinates": ("x", "z"),
        "angles": ("x", "z"),
        "period": 1.0,
        "jumps": [{"when": half, "direction": "up", "then": cat_of}],
    }


@pytest.mark.slow  # a linear flow and Lorenz are quick, and the matrix has clocks
def test_the_cat_suspended_in_a_flow():
    """Its vectors are at right angles and grow by the golden mean squared a period, whatever the field does between."""
    session = jaxnh.Session(suspended_cat, start={"x": 1.0, "z": 0.3}, target=1e-7)
    data = session.run(jaxnh.Covariant(strobes=1024, transient=8))
    assert data["exponents"].to_numpy() == pytest.approx([GOLDEN, -GOLDEN], abs=1e-9)
    assert float(data["angle_min"][0]) == pytest.approx(np.pi / 2, abs=1e-6)
    assert words(data, "kind") == "hyperbolic"


def test_the_cat_map_is_hyperbolic():
    """Its matrix is symmetric: vectors are at right angles everywhere, and grow by the golden mean squared."""
    data = jaxnh.Session(cat, start={"x": 1.0, "z": 0.3}).run(jaxnh.Covariant(strobes=1024, transient=8))
    assert data["exponents"].to_numpy() == pytest.approx([GOLDEN, -GOLDEN], abs=1e-12)
    assert float(data["angle_min"][0]) == pytest.approx(np.pi / 2, abs=1e-7)
    assert words(data, "kind") == "hyperbolic"


def turning(r=0.8, turn=1.0, tilt=0.5):
    """A plane that turns and shrinks, and a direction at an angle to it, by its tangent, that shrinks faster."""

    def image(s):
        x, y, z = s
        c, q = r * jnp.cos(turn), r * jnp.sin(turn)
        u = x - tilt * z
        return c * u - q * y + tilt * 0.3 * z, q * u + c * y, 0.3 * z

    return {"map": image, "coordinates": ("x", "y", "z")}


def test_directions_of_equal_exponents_have_no_angle():
    """A focus has no directions of its own: which are taken depends on where the sweeps began. Strobes rest, at zero."""
    data = jaxnh.Session(turning, start={"x": 1.0, "y": 0.3, "z": 0.2}).run(
        jaxnh.Covariant(strobes=1024, transient=4096)
    )
    assert np.all(np.abs(data["exponents"] - np.log([0.8, 0.8, 0.3])) <= data["exponents_error"])
    assert list(jaxnh.labels(data["tangency"])) == ["undecided", "bounded"]
    for name in ("angle_min", "angle_min_half", "angle_min_quarter", "angle_median"):
        assert np.isnan(data[name][0])
    assert np.isnan(data["angle_density"][0]).all()
    assert float(data["angle_min"][1]) == pytest.approx(np.arctan(2.0), abs=1e-7)
    assert words(data, "kind") == "regular"


def coupled(eps=0.3, r=3.7):
    """Two logistic maps: in step from 0.3 on, at 0.02 both directions grow, and nowhere are they all stretched."""

    def image(s):
        f, g = (r * x * (1.0 - x) for x in s)
        return f + eps * (g - f), g + eps * (f - g)

    return {"map": image, "coordinates": ("x", "y")}


def test_maps_that_fold_are_not_said_to_be_hyperbolic():
    """At x = 1/2 a tangent of the logistic map vanishes, whatever the angles are; with two growing ones there is none."""
    session = jaxnh.Session(coupled, start={"x": 0.3, "y": 0.6})
    data = session.run(jaxnh.Covariant(strobes=1024), eps=[0.02, 0.3])
    assert np.all((data["exponents"] > data["exponents_error"]).sum("exponent") == [2, 1])
    assert words(data, "tangency")[1] == ["bounded"]  # at right angles
    assert words(data, "kind") == ["undecided", "undecided"]


def test_growth_of_volumes():
    """Of random matrices: that of the first vector by itself, and of all of them by the determinant."""
    matrices = np.random.default_rng(4).normal(size=(1, 300, 3, 3))
    vectors = covariant_vectors(matrices, 100, 3)
    grown = volume_growth(vectors)
    assert grown[0, 0] == pytest.approx(vectors.growth[0, :-1, 0], abs=1e-12)
    assert grown[0, 2] == pytest.approx(np.log(np.abs(np.linalg.det(matrices[0, 100:199]))), abs=1e-9)


def test_henons_attractor_has_tangencies():
    """As the literature knows; the exponents are those of `lyapunov`. One lane escapes."""
    session = jaxnh.Session(henon, start={"x": 0.1, "y": 0.1})
    a = np.array([1.39, 1.4, 1.6])
    data, plain = session.run("covariant", a=a), session.run("lyapunov", a=a)
    assert words(data, "kind") == ["tangent", "tangent", "failed"]
    assert words(data, "tangency") == [["tangent"], ["tangent"], ["undecided"]]
    apart = np.abs(data["exponents"] - plain["exponents"]).to_numpy()[:2]
    assert np.all(apart < (data["exponents_error"] + plain["exponents_error"]).to_numpy()[:2])
    sums, error = data["exponents"].sum("exponent").to_numpy(), data["exponents_error"].max("exponent").to_numpy()
    assert np.all(np.abs(sums - np.log(0.3))[:2] < error[:2])  # but for the angles at both ends
    assert np.isnan(data["exponents"].to_numpy()[2]).all()
    assert np.all((data["angle_min"] <= data["angle_min_half"]).to_numpy()[:2])
    assert data["angle_density"].to_numpy()[:2].sum(axis=-1) == pytest.approx(36 / (0.5 * np.pi))


def lorenz_session():
    session = jaxnh.Session(lorenz.lorenz, start={"x": 1.0, "y": 1.0, "z": 20.0}, target=1e-8)
    return session.on(coordinate="z", value=27.0, direction="down")


def test_lorenzs_attractor():
    """Stable and unstable directions of the section stay apart at rho = 28; sums are the divergence."""
    data = lorenz_session().run(jaxnh.Covariant(strobes=1024), rho=[28.0])
    assert words(data, "kind") == ["hyperbolic"]
    assert float(data["angle_min"].min()) > 1.0
    sums, error = data["exponents"].sum("exponent").to_numpy(), data["exponents_error"].max("exponent").to_numpy()
    assert np.abs(sums + 10.0 + 1.0 + 8.0 / 3.0) < error
    assert np.abs(data["exponents"].isel(exponent=0) - 0.9056) < data["exponents_error"].isel(exponent=0)


def test_a_search_shows_henons_tangencies():
    """Of 256 points nothing is said; beside them angles change their sign."""
    session = jaxnh.Session(henon, start={"x": 0.1, "y": 0.1})
    few, searched = (session.run(jaxnh.Covariant(strobes=256, search=rounds), a=[1.2, 1.4]) for rounds in (0, 24))
    assert words(few, "kind") == ["undecided", "undecided"]
    assert words(searched, "kind") == ["tangent", "tangent"]
    assert np.all((searched["angle_found"] < 0.01).to_numpy())
    assert "angle_found" not in few


def lozi(a=1.7, b=0.5):
    """Uniformly hyperbolic where it is smooth (Misiurewicz, Ann. N.Y. Acad. Sci. 357 (1980) 348): directions in cones."""

    def image(s):
        x, y = s
        return 1.0 - a * jnp.abs(x) + y, b * x

    return {"map": image, "coordinates": ("x", "y")}


def test_returns_in_which_directions_settle():
    """By the slower of what parts directions and what shrinks across the leaf, e^−23; none where that takes over 64."""
    growth = np.array([[0.5, -2.0, -3.0], [0.1, -0.2, -3.0], [0.5, 0.0, -1.0], [0.5, 0.0, -1.0]])
    needed = [settling_returns(growth, np.full(4, 1), neutral)[i] for i, neutral in enumerate((0, 0, 0, 1))]
    assert needed == [16, 0, 0, 64]


def test_a_search_finds_no_tangency_where_there_is_none():
    """Directions of Lozi's map jump at its corner and their angles are above a bound by its cones; those of the cat rest.

    A vector (1, v) that grows has |v| ≤ κ, and one (v, 1) that shrinks |v| ≤ κ / b, of κ = b / λ and the
    least stretch λ = (a + √(a² − 4 b)) / 2; in sizes of the motion, whose ratio is b, κ is 1 / λ.
    """
    data = jaxnh.Session(lozi, start={"x": 0.1, "y": 0.1}).run(jaxnh.Covariant(strobes=1024, search=12), a=[1.7])
    assert words(data, "kind") == ["hyperbolic"]
    stretch = 0.5 * (1.7 + np.sqrt(1.7**2 - 2.0))
    least = np.pi / 2 - np.arctan(1.0 / stretch) - np.arctan(0.5 / stretch)
    assert least < float(data["angle_found"][0, 0]) <= float(data["angle_min"][0, 0])
    data = jaxnh.Session(cat, start={"x": 1.0, "z": 0.3}).run(jaxnh.Covariant(strobes=1024, transient=8, search=2))
    assert float(data["angle_found"][0]) == pytest.approx(np.pi / 2, abs=1e-7)


@pytest.mark.slow  # the same search on maps is quick
def test_lorenzs_tangencies_begin_at_31():
    """A search has them on the right side of 31.008, where they begin by DOP853.

    Motions come near the first ones where they have passed the stable manifold of the origin closely: 1,024 points
    meet none at 31.1, and the verdict would be hyperbolic. Returns 1e-6 off move no tangency by as much as 0.1 of ρ.
    """
    session = jaxnh.Session(lorenz.lorenz_from_equilibria, start={"x": 1.0, "y": 1.0, "w": -8.0}, target=1e-6)
    session = session.on(coordinate="w", value=0.0, direction="down")
    rho = [30.9, 31.1]
    assert rho[0] < lorenz.first_tangency() < rho[1]
    few = session.run(jaxnh.Covariant(strobes=1024), rho=rho)
    assert words(few, "kind") == ["hyperbolic"] * 2
    data = session.run(jaxnh.Covariant(strobes=1024, search=96), rho=rho)
    assert words(data, "kind") == ["hyperbolic", "tangent"]


@pytest.mark.slow  # the matrix has the particle
def test_the_papers_particle():
    """What the page says of it, of half as many points: its chaos at b = 5.3, and disturbed at 5.6, has tangencies."""
    experiment = jaxnh.load(ROOT / "configs" / "covariant.yaml", ["analyses.covariant.strobes=4096"])
    data = jaxnh.run(experiment)["covariant"].to_dataset()
    assert words(data, "kind") == [["tangent", "regular"], ["tangent", "tangent"]]
    chaotic = data.isel(d=xr.DataArray([0, 1]), b=xr.DataArray([0, 1])).transpose(..., "split", "exponent", "angle")
    assert np.all(chaotic["angle_min"][:, 0] < 2e-3)
    assert chaotic["angle_median"].to_numpy()[:, 0] == pytest.approx([0.13, 0.41], rel=0.1)


def test_where_lorenzs_tangencies_begin():
    """By DOP853 at 31.01, as is quoted of Creaser, Krauskopf and Osinga (SIAM J. Appl. Dyn. Syst. 16 (2017) 2127)."""
    assert lorenz.first_tangency() == pytest.approx(31.01, abs=5e-3)


def test_directions_are_needed():
    def one(r=3.7):
        return {"map": lambda y: r * y[0] * (1.0 - y[0]), "coordinates": "x"}

    with pytest.raises(jaxnh.InputError, match="angles are between directions of the map, and it has one alone"):
        jaxnh.Session(one, start={"x": 0.3}).run("covariant")
