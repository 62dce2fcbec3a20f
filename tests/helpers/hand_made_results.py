"""Groups of results made by hand, with the attributes that say how they are drawn: for tests of figures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

WORDS = {"x1": "position x1", "x2": "velocity x2 = dx1/dt", "y1": "position y1", "y2": "velocity y2 = dy1/dt"}
ATTRS = {
    "title": "A little of everything",
    "jaxnh_version": "0.1.0",
    "solver": "blanes_moan6",
    "steps_per_period": np.int64(60),
    "error_estimate": np.float64(1e-5),
    "strobe_period": np.float64(2 * np.pi),
}


def dataset(axes, variables, **attrs):
    """A group as the store writes it.

    Args:
        axes: name to values and words.
        variables: name to dims, data, words, units and perhaps attributes.
        attrs: of the group.
    """
    named = {
        name: xr.Variable(dims, data, {"long_name": words, "units": units, **dict(*more)})
        for name, (dims, data, words, units, *more) in variables.items()
    }
    coords = {
        name: xr.Variable((name,), np.asarray(values, float), {"long_name": words, "units": "1"})
        for name, (values, words) in axes.items()
    }
    return xr.Dataset(named, coords=coords, attrs=attrs)


def states(b, points, dim="strobe", panel="density", seed=0):
    """States of the paper's particle over b."""
    rng = np.random.default_rng(seed)
    variables = {name: (("b", dim), rng.normal(size=(len(b), points)), words, "1") for name, words in WORDS.items()}
    shown = "x1" if panel == "density" else "x1 x2"
    return dataset({"b": (b, "coupling b")}, variables, panel=panel, panel_variables=shown)


def exponents(b, count):
    values = np.random.default_rng(0).normal(size=(len(b), count))
    error = {"ancillary_variables": "exponents_error"}
    return dataset(
        {"b": (b, "coupling b")},
        {
            "exponents": (("b", "exponent"), values, "Lyapunov exponents, natural logarithm", "1/time", error),
            "exponents_error": (("b", "exponent"), 0.1 + 0 * values, "error of the exponents at 95 %", "1/time"),
        },
        panel="curves",
        panel_variables="exponents",
        panel_label="largest Lyapunov exponent" if count == 1 else "Lyapunov exponents",
    ).assign_coords(exponent=np.arange(1, count + 1))


def doublings(values=(5.52, 5.495, 5.489, np.nan), name="b", words="coupling b at the doubling"):
    count = len(values)
    level, delta = np.arange(1, count + 1), np.full(count, np.nan)
    if count > 1:
        delta[1] = 4.1
    return dataset(
        {},
        {
            "period": (("level",), 2 ** (level - 1), "period n of the orbit that doubles to 2n", "forcing periods"),
            name: (("level",), np.array(values), words, "1"),
            f"{name}_error": (("level",), 0 * delta, f"error of {name}", "1"),
            "delta": (("level",), delta, "ratio δ of successive distances between doublings", "1"),
            "delta_error": (("level",), 0 * delta, "error of δ", "1"),
        },
        panel="cascade",
        panel_variables=f"{name} delta",
        along=name,
    ).assign_coords(level=level)


def periods(b, units="periods of the forcing"):
    n = np.resize([0, 1, 2, 4, 24], len(b))
    variables = {"period": (("b",), n, "least period, 0: none up to the limit", units)}
    look = {"panel": "integers", "panel_variables": "period", "panel_label": "least period"}
    return dataset({"b": (b, "coupling b")}, variables, **look)


def radial_responses(b):
    """Phase responses of a cycle whose isochrons are radii."""
    phase = 2 * np.pi * np.arange(32) / 32
    curves = {"x1": -np.sin(phase), "x2": np.cos(phase)}
    variables = {
        f"{name}_response{end}": (("b", "phase"), np.tile(factor(curve), (len(b), 1)), f"{words} of {name}", "rad")
        for name, curve in curves.items()
        for end, factor, words in (("", np.array, "derivative of the phase"), ("_error", np.abs, "error"))
    }
    look = {"panel": "phase_responses", "panel_variables": "x1_response x2_response"}
    made = dataset({"b": (b, "coupling b")}, variables, **look).assign_attrs(axes="b")
    return made.assign_coords(phase=("phase", phase, {"long_name": "phase after the section", "units": "rad"}))


def growth_rates(b):
    k = np.linspace(0, 1, len(b))
    variables = {
        "k_median": (("b",), k, "growth rate of the walk", "1", {"ancillary_variables": "k_spread"}),
        "k_spread": (("b",), 0.2 + 0 * k, "half the distance between the quartiles", "1"),
    }
    look = {"panel": "curves", "panel_variables": "k_median", "panel_label": "0–1 test, $K$", "panel_levels": "0 1"}
    return dataset({"b": (b, "coupling b")}, variables, **look)


def verdicts(b):
    meanings = {"flag_values": np.arange(4, dtype=np.int8), "flag_meanings": "periodic quasiperiodic chaotic undecided"}
    kind = np.resize([0, 2, 0, 3], len(b)).astype(np.int8)
    variables = {"kind": (("b",), kind, "kind of motion", "1", meanings)}
    look = {"panel": "flags", "panel_variables": "kind", "panel_label": "verdict"}
    return dataset({"b": (b, "coupling b")}, variables, **look)


def tree(groups, axes="b", **attrs):
    """A result of several groups."""
    made = xr.DataTree.from_dict(groups)
    made.attrs = {**ATTRS, "axes": axes, **attrs}
    return made


def write(path: Path, result: xr.DataTree) -> Path:
    """A result file."""
    result.to_netcdf(path, engine="h5netcdf")
    return path


def basin_shares(b):
    """Shares of three basins over a parameter, the last of which ends, and some of the lanes undecided at its end."""
    fraction = np.linspace([0.5, 0.3, 0.2], [0.9, 0.0, 0.0], len(b))
    bars = {"fraction": fraction, "fraction_low": fraction - 0.02, "fraction_high": fraction + 0.03}
    axes = {"b": (np.asarray(b), "coupling b", "1"), "attractor": (np.arange(1, 4), "number of the attractor", "1")}
    variables = {name: xr.Variable(("b", "attractor"), np.clip(values, 0.0, 1.0)) for name, values in bars.items()}
    coordinates = {n: xr.Variable(n, v, {"long_name": w, "units": u}) for n, (v, w, u) in axes.items()}
    attrs = {"panel": "shares", "panel_variables": "fraction", "axes": "b"}
    return xr.Dataset(variables, coordinates, attrs)


def cascade_branches():
    """Periods 1 and 2 of x → b x (1 − x) about the doubling at 3, each stable in part; the second is shorter."""
    b = np.full((2, 40), np.nan)
    b[0], b[1, :20] = np.linspace(2.5, 3.6, 40), np.linspace(3.0, 3.6, 20)
    x = np.full((2, 40, 2), np.nan)
    x[0, :, 0] = 1 - 1 / b[0]
    middle, half = 0.5 * (1 + 1 / b[1]), 0.5 * np.sqrt((1 - 3 / b[1]) * (1 + 1 / b[1]))
    x[1] = middle[:, None] + half[:, None] * [-1.0, 1.0]
    stable = np.where(np.isfinite(b), np.where([[True], [False]], b < 3, b < 1 + np.sqrt(6)), -1).astype(np.int8)
    variables = {
        "b": (("branch", "point"), b, "coupling b", "1"),
        "x1_points": (("branch", "point", "iterate"), x, WORDS["x1"], "1"),
        "stable": (("branch", "point"), stable, "1 where the orbit attracts", "1"),
        "period": (("branch",), np.array([1, 2]), "period", "periods"),
    }
    return dataset({}, variables, panel="branches", panel_variables="x1_points", along="b")


def cat_manifolds():
    """Both manifolds of the fixed point of Arnold's cat map: straight lines of the slopes (√5 − 1)/2 and −(√5 + 1)/2."""
    along = np.linspace(0.0, 1.0, 20)
    slopes = np.array(
        [0.5 * (np.sqrt(5) - 1), 0.5 * (np.sqrt(5) - 1), -0.5 * (np.sqrt(5) + 1), -0.5 * (np.sqrt(5) + 1)]
    )
    sign = np.array([1.0, -1.0, 1.0, -1.0])
    x = (sign * [1.0, 1.0, 0.3, 0.3])[:, None] * along
    flags = {"flag_values": np.arange(2), "flag_meanings": "unstable stable"}
    variables = {
        "x1_points": (("b", "saddle", "branch", "point"), x[None, None], WORDS["x1"], "1"),
        "y1_points": (("b", "saddle", "branch", "point"), (slopes[:, None] * x)[None, None], WORDS["y1"], "1"),
        "branch_kind": (("branch",), np.array([0, 0, 1, 1], np.int8), "kind of branch", "1", flags),
    }
    axes = {"b": (np.ones(1), "coupling b")}
    drawn = dataset(axes, variables, panel="manifolds", panel_variables="x1_points y1_points")
    return drawn.assign_attrs(axes="b")


def saddle_surface():
    """The graph z = x y over a square, in triangles, as a stable manifold of zero."""
    side = np.linspace(-1.0, 1.0, 9)
    x, y = (leaf.ravel() for leaf in np.meshgrid(side, side, indexing="ij"))
    corner = np.arange(8)[:, None] * 9 + np.arange(8)
    triangles = np.stack([corner, corner + 1, corner + 9, corner + 10, corner + 9, corner + 1], axis=-1).reshape(-1, 3)
    over, flags = ("b", "saddle", "surface"), {"flag_values": np.arange(2), "flag_meanings": "unstable stable"}
    points = {"x": x, "y": y, "z": x * y}
    variables = {
        **{f"{name}_points": ((*over, "point"), leaf[None, None, None], name, "m") for name, leaf in points.items()},
        "arc_length": ((*over, "point"), np.hypot(x, y)[None, None, None], "arc length", "1"),
        "triangles": ((*over, "triangle", "corner"), triangles[None, None, None], "corners", "1"),
        "surface_kind": (("b", "surface"), np.ones((1, 1), np.int8), "kind of surface", "1", flags),
    }
    drawn = dataset(
        {"b": (np.ones(1), "coupling b")}, variables, panel="surfaces", panel_variables="x_points y_points z_points"
    )
    return drawn.assign_attrs(axes="b")


def cascade_marks():
    """Its first two doublings, and a fold that is none of it, subcritical."""
    x = np.array([[2 / 3, np.nan], [0.4399, 0.8499], [0.5, np.nan]])
    flags = {"flag_values": np.arange(2), "flag_meanings": "fold period_doubling"}
    variables = {
        "b": (("bifurcation",), np.array([3.0, 1 + np.sqrt(6), 2.6]), "coupling b", "1"),
        "x1_points": (("bifurcation", "iterate"), x, WORDS["x1"], "1"),
        "kind": (("bifurcation",), np.array([1, 1, 0]), "kind of bifurcation", "1", flags),
        "criticality": (("bifurcation",), np.array([1, 1, -1]), "criticality", "1"),
    }
    return dataset({}, variables, panel="marks", panel_variables="x1_points", along="b")


def cusp_curves():
    """The fold curve of x' = p + q x − x³ with its cusp at (0, 0), and a doubling of period 2 that is none of it."""
    x = np.linspace(-0.6, 0.6, 31)
    p, q = np.full((2, 31), np.nan), np.full((2, 31), np.nan)
    p[0], q[0] = -2 * x**3, 3 * x**2
    p[1, :10], q[1, :10] = np.linspace(-0.4, 0.4, 10), 0.2
    flags = {"flag_values": np.arange(2), "flag_meanings": "fold period_doubling"}
    special = {"flag_values": np.arange(2), "flag_meanings": "cusp generalised_doubling"}
    variables = {
        "p": (("curve", "point"), p, "push p", "1"),
        "q": (("curve", "point"), q, "stiffness q", "1"),
        "kind": (("curve",), np.array([0, 1]), "kind of bifurcation", "1", flags),
        "period": (("curve",), np.array([1, 2]), "period", "periods"),
        "codimension_two_p": (("codimension_two",), np.zeros(1), "push p", "1"),
        "codimension_two_q": (("codimension_two",), np.zeros(1), "stiffness q", "1"),
        "codimension_two_kind": (("codimension_two",), np.zeros(1, int), "point of codimension two", "1", special),
    }
    return dataset({}, variables, panel="bifurcation_curves", panel_variables="p q", over="p q")


def cusp_point():
    """The point of codimension two of `cusp_curves`, by itself."""
    curves = cusp_curves()
    variables = {
        "p": curves["codimension_two_p"],
        "q": curves["codimension_two_q"],
        "kind": curves["codimension_two_kind"],
    }
    return xr.Dataset(variables, attrs={**curves.attrs, "panel": "special_points"})


def torus_rows():
    """Two branches of tori: from a bifurcation at 0 around a fold, and a shorter one from a lane."""
    flags = {"flag_values": np.arange(3), "flag_meanings": "attracting repelling none"}
    dims, square = ("torus_branch", "torus_point"), np.linspace(0.0, 1.0, 9)
    along = np.stack([square**2 - square, np.where(square < 0.4, square, np.nan)])
    turns = np.stack([0.2 + 0.3 * square, np.where(square < 0.4, 0.7 - 0.1 * square, np.nan)])
    kind = np.stack([np.where(square < 0.5, 1, 0), np.where(square < 0.4, 0, 2)])
    variables = {
        "b": (dims, along, "coupling b", "1"),
        "rotation": (dims, turns, "rotation number on the curve", "1"),
        "kind": (dims, kind, "the invariant curve", "1", flags),
        "birth": (("torus_branch",), np.array([0.0, np.nan]), "coupling b at the birth", "1"),
        "period": (("torus_branch",), np.array([1, 2]), "period of the orbit", "1"),
    }
    return dataset({}, variables, panel="torus_branches", panel_variables="rotation", along="b")


def window_rows():
    """Three windows of the logistic map: period 3 with all that is known, 5 from a fold on, 1 from beyond the range."""
    flags = {
        "flag_values": np.arange(6),
        "flag_meanings": "fold branch_point range not_located neimark_sacker period_doubling",
    }
    numbers = {
        "period": [1, 3, 5],
        "first": [2.0, 3.83, 3.739],
        "last": [3.56, 3.849, 3.743],
        "begin": [np.nan, 1 + np.sqrt(8), 3.738173],
        "end": [3.0, 3.841499, np.nan],
        "limit": [3.569946, 3.849500, np.nan],
        "crisis": [np.nan, 3.856800, np.nan],
    }
    variables = {name: (("window",), np.array(values), f"{name} of a window", "1") for name, values in numbers.items()}
    variables["period"] = (("window",), np.array(numbers["period"]), "period of the window", "periods")
    variables["b"] = (("searched",), np.array([2.0, 4.0]), "coupling b", "1")
    variables["begin_kind"] = (("window",), np.array([2, 0, 0]), "kind of the begin", "1", flags)
    variables["end_kind"] = (("window",), np.array([5, 5, 3]), "kind of the end", "1", flags)
    return dataset({}, variables, panel="windows", panel_variables="period", along="b")


def logistic_atlas():
    """An atlas of x → (b + d) x (1 − x) over b and d: at b + d = 3 the orbit of period 1 doubles, at x = 2/3.

    Beside it a chart of periods, rotation numbers that are locked to a half where the period is two, and shares of
    one attractor, or two below d = 0.15.
    """
    b, d, rows = np.linspace(2.5, 3.3, 9), np.linspace(0.0, 0.4, 5), np.array([0.0, 0.4])
    axes = {"b": (b, "coupling b"), "d": (d, "depth d")}
    doubled = b[:, None] + d > 3.0
    along = np.linspace(2.5, 3.3, 17)
    point = 1 - 1 / (along + rows[:, None])
    flags = {"flag_values": np.arange(2), "flag_meanings": "fold period_doubling"}
    kinds = {"flag_values": np.arange(2), "flag_meanings": "locked unlocked"}
    motions = {"flag_values": np.array([-1, 0]), "flag_meanings": "absent periodic"}
    ends = {"flag_values": np.arange(2), "flag_meanings": "range period_doubling"}
    row = ("number of the row", "1")
    depth = np.linspace(0.0, 0.4, 9)
    numbers = {"b": 3.0 - depth, "d": depth}
    curve = {name: (("curve", "point"), values[None], name, "1") for name, values in numbers.items()}
    curve |= {f"{name}_error": (("curve", "point"), 0 * depth[None], f"error of {name}", "1") for name in numbers}
    fraction = np.stack([np.where(d < 0.15, 0.6, 1.0), np.where(d < 0.15, 0.4, 0.0)], axis=-1)
    fraction = np.broadcast_to(fraction, (9, 5, 2))
    window = {"first": along[:1], "last": along[-1:], "begin": [np.nan], "end": [3.0], "limit": [np.nan]}
    groups = {
        "period": dataset(
            axes,
            {
                "period": (("b", "d"), np.where(doubled, 2, 1), "least period", "1"),
                "multiplier": (("b", "d"), 0.5 + 0.0 * doubled, "largest multiplier", "1"),
                "status": (("b", "d"), 0 * doubled, "status", "1"),
            },
        ),
        "rotation": dataset(
            axes,
            {
                "rotation": (("b", "d"), np.where(doubled, 0.5, 0.0), "rotation number", "1"),
                "rotation_error": (("b", "d"), 0.0 * doubled, "error", "1"),
                "kind": (("b", "d"), 0 * doubled, "kind of rotation", "1", kinds),
                "numerator": (("b", "d"), np.where(doubled, 1, 0), "numerator", "1"),
                "denominator": (("b", "d"), np.where(doubled, 2, 1), "denominator", "1"),
            },
        ),
        "attractors": dataset(
            axes,
            {
                "fraction": (("b", "d", "attractor"), fraction, "share", "1"),
                "fraction_low": (("b", "d", "attractor"), fraction - 0.1, "share", "1"),
                "fraction_high": (("b", "d", "attractor"), fraction + 0.1, "share", "1"),
                "kind": (("b", "d", "attractor"), np.where(fraction > 0, 0, -1), "kind", "1", motions),
                "period": (("b", "d", "attractor"), np.where(fraction > 0, 1, 0), "period", "periods"),
                "x1_points": (("b", "d", "attractor", "point"), fraction[..., None], WORDS["x1"], "1"),
            },
        ).assign_coords(attractor=np.arange(1, 3)),
        "branches": dataset(
            {},
            {
                "b": (("branch", "point"), np.tile(along, (2, 1)), "coupling b", "1"),
                "x1_points": (("branch", "point", "iterate"), point[..., None], WORDS["x1"], "1"),
                "stable": (("branch", "point"), (along + rows[:, None] < 3).astype(np.int8), "attracts", "1"),
                "period": (("branch",), np.ones(2, int), "period", "periods"),
                "row": (("branch",), np.arange(2), *row),
                "d": (("branch",), rows, "depth d", "1"),
            },
            rows="d",
        ),
        "bifurcations": dataset(
            {},
            {
                "b": (("bifurcation",), 3.0 - rows, "coupling b", "1"),
                "b_error": (("bifurcation",), 0 * rows, "error of b", "1"),
                "x1_points": (("bifurcation", "iterate"), np.full((2, 1), 2 / 3), WORDS["x1"], "1"),
                "kind": (("bifurcation",), np.ones(2, int), "kind of bifurcation", "1", flags),
                "criticality": (("bifurcation",), np.ones(2, int), "criticality", "1"),
                "branch": (("bifurcation",), np.arange(2), "number of the branch", "1"),
                "curve": (("bifurcation",), np.zeros(2, int), "number of the curve", "1"),
                "row": (("bifurcation",), np.arange(2), *row),
                "d": (("bifurcation",), rows, "depth d", "1"),
            },
            rows="d",
        ),
        "windows": dataset(
            {},
            {
                **{name: (("window",), np.array(values), name, "1") for name, values in window.items()},
                "crisis": (("window",), np.array([np.nan]), "crisis", "1"),
                "period": (("window",), np.ones(1, int), "period", "periods"),
                "begin_kind": (("window",), np.zeros(1, int), "kind of the begin", "1", ends),
                "end_kind": (("window",), np.ones(1, int), "kind of the end", "1", ends),
                "b": (("searched",), np.array([2.5, 3.3]), "coupling b", "1"),
                "row": (("window",), np.zeros(1, int), *row),
                "d": (("window",), rows[:1], "depth d", "1"),
            },
            rows="d",
        ),
        "curves": dataset(
            {},
            {
                **curve,
                "kind": (("curve",), np.ones(1, int), "kind of bifurcation", "1", flags),
                "period": (("curve",), np.ones(1, int), "period", "periods"),
            },
        ),
        "codimension_two": dataset(
            {},
            {
                **{name: (("codimension_two",), values[4:5], name, "1") for name, values in numbers.items()},
                **{f"{name}_error": (("codimension_two",), np.zeros(1), "error", "1") for name in numbers},
                "kind": (("codimension_two",), np.zeros(1, int), "kind", "1", flags),
                "curve": (("codimension_two",), np.zeros(1, int), "number of the curve", "1"),
            },
        ),
        "curve_orbits": dataset(
            {}, {"x1_points": (("curve", "point", "iterate"), np.full((1, 9, 1), 2 / 3), WORDS["x1"], "1")}
        ),
        "atlas": dataset(
            {},
            {
                "d": (("row",), rows, "depth d", "1"),
                "curves": ((), np.int64(1), "number of curves", "1"),
                "cut": ((), np.int64(0), "number of curves that go on", "1"),
                "not_located": ((), np.int64(0), "number that could not be located", "1"),
                "spacing": ((), 0.1, "largest distance of lanes", "1"),
            },
            over="b d",
            complete_to="orbits of periods up to 1 that lanes settle on after 16 periods, at d = 0, 0.4",
        ),
    }
    return tree(groups, axes="b d")
