"""Panels by kind: what is drawn is the data, whole and named."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxnh.exceptions import ResultError
from jaxnh.plotting.descriptions import describe
from jaxnh.plotting.panels import PANELS
from jaxnh.plotting.results import figure
from tests.helpers.hand_made_results import (
    WORDS,
    basin_shares,
    cascade_branches,
    cascade_marks,
    cat_manifolds,
    cusp_curves,
    cusp_point,
    dataset,
    doublings,
    exponents,
    growth_rates,
    periods,
    radial_responses,
    saddle_surface,
    states,
    torus_rows,
    tree,
    verdicts,
    window_rows,
)

rng = np.random.default_rng(0)
MANY, FEW = np.linspace(6.0, 0.1, 500), np.array([5.8, 2.5, 4.1, 5.3])
(
    trajectories,
    points,
    density,
    cascade,
    curves,
    integers,
    flags,
    basins,
    shares,
    branches,
    marks,
    bifurcation_curves,
    special_points,
    windows,
    torus_branches,
    manifolds,
    surfaces,
    phase_responses,
) = (
    PANELS[name].draw
    for name in (
        "trajectories",
        "points",
        "density",
        "cascade",
        "curves",
        "integers",
        "flags",
        "basins",
        "shares",
        "branches",
        "marks",
        "bifurcation_curves",
        "special_points",
        "windows",
        "torus_branches",
        "manifolds",
        "surfaces",
        "phase_responses",
    )
)


def paths(count=64):
    return states(FEW, count, "time", "trajectories")


def strobes(count=8, **attrs):
    return states(FEW, count, panel="points", seed=1).assign_attrs(attrs)


DRAWINGS = {
    "trajectories": lambda ax: trajectories(paths(), ax, lane=1, over=[strobes()]),
    "points": lambda ax: points(strobes(), ax, lane=2),
    "density": lambda ax: density(states(MANY, 50), ax),
    "few points": lambda ax: density(states(FEW, 50), ax),
    "cascade": lambda ax: cascade(doublings(), ax),
    "exponents": lambda ax: curves(exponents(MANY, 3), ax),
    "largest exponent": lambda ax: curves(exponents(FEW, 1), ax),
    "one curve": lambda ax: curves(growth_rates(MANY), ax),
    "integers": lambda ax: integers(periods(MANY), ax),
    "flags": lambda ax: flags(verdicts(MANY), ax),
    "basins": lambda ax: basins(periods(MANY), ax),
    "shares": lambda ax: shares(basin_shares(MANY), ax),
    "branches": lambda ax: branches(cascade_branches(), ax, marks=[cascade_marks()], under=[states(FEW, 50)]),
    "marks": lambda ax: marks(cascade_marks(), ax),
    "bifurcation_curves": lambda ax: bifurcation_curves(cusp_curves(), ax),
    "special_points": lambda ax: special_points(cusp_point(), ax),
    "windows": lambda ax: windows(window_rows(), ax),
    "torus_branches": lambda ax: torus_branches(torus_rows(), ax),
    "manifolds": lambda ax: manifolds(cat_manifolds(), ax),
    "surfaces": lambda ax: surfaces(saddle_surface(), ax),
    "phase_responses": lambda ax: phase_responses(radial_responses(FEW), ax, lane=1),
}


def test_every_kind_is_drawn_here():
    assert set(PANELS) <= set(DRAWINGS) | {"curves"}


@pytest.mark.parametrize("name", DRAWINGS)
def test_axes_are_returned_and_named(name):
    """Given axes come back; without any, new ones do. Both axes say what they show, and its units where it has any."""
    ax = Figure().subplots()
    assert DRAWINGS[name](ax) is ax
    alone = DRAWINGS[name](None)
    assert isinstance(alone, Axes)
    for axes in (ax, alone):
        labels = axes.get_xlabel(), axes.get_ylabel()
        if name == "surfaces":  # named along the edges of their box
            labels = [text.get_text() for text in axes.texts]
            assert len(labels) == 3
        assert "(" in labels[0]
        assert all("(" in label for label in labels[1:]) or name == "flags"
        axes.figure.draw_without_rendering()


@pytest.mark.parametrize("name", DRAWINGS)
def test_limits_contain_what_is_drawn(name):
    """Every point of every line and the whole of every image lie within the axes."""
    ax = DRAWINGS[name](None)
    ax.figure.draw_without_rendering()
    (left, right), (low, high) = sorted(ax.get_xlim()), sorted(ax.get_ylim())
    lines = [line for line in ax.get_lines() if line.get_transform() == ax.transData]  # none that goes across the axes
    assert lines or ax.images
    for line in lines:
        x, y = line.get_data()
        assert np.nanmin(x) >= left
        assert np.nanmax(x) <= right
        assert np.nanmin(y) >= low
        assert np.nanmax(y) <= high
    for image in ax.images:
        x0, x1, y0, y1 = image.get_extent()
        assert (x0, x1) == pytest.approx((left, right))
        assert low <= y0 < y1 <= high


# ---- planes


def test_points_lie_over_their_trajectory():
    ax = trajectories(paths(), lane=2, over=[strobes()])
    path, dots = ax.lines
    assert np.array_equal(path.get_xydata(), np.column_stack([paths()["x1"][2], paths()["x2"][2]]))
    assert np.array_equal(dots.get_xydata(), np.column_stack([strobes()["x1"][2], strobes()["x2"][2]]))
    assert dots.get_zorder() > path.get_zorder()
    assert ax.get_title() == "(c) $b$ = 4.1"


def test_a_section_is_named():
    assert points(strobes(section="y1 = 0, up"), lane=3).get_title() == "(d) $b$ = 5.3, on y1 = 0, up"
    ax = density(states(FEW, 5).assign_attrs(section="y1 = 0, up"))
    assert ax.get_title("left") == "on y1 = 0, up"


def moved_across_the_seam(data, name):
    """The same with a coordinate moved by half a turn, and whole turns taken off, as an angle."""
    moved = (data[name] + np.pi + np.pi) % (2 * np.pi) - np.pi
    assert moved.min() < -2.0
    assert moved.max() > 2.0
    return data.assign({name: moved.assign_attrs(data[name].attrs | {"long_name": "angle x"})})


def test_a_surface_across_the_seam_of_an_angle_is_whole():
    """It looks as that of a coordinate that runs on, from where it begins."""
    plain = saddle_surface()
    faces = [
        np.array([path.vertices for path in surfaces(data).collections[0].get_paths()])
        for data in (plain, moved_across_the_seam(plain, "x_points"))
    ]
    np.testing.assert_allclose(faces[1], faces[0], atol=1e-12)


def test_manifolds_end_at_the_seam_of_an_angle():
    """And go on at its other side, without a line across the picture."""
    for line in manifolds(moved_across_the_seam(cat_manifolds(), "x1_points")).get_lines()[:2]:
        x = line.get_xdata()
        assert np.sum(np.isfinite(x)) == 40
        assert np.nanmax(np.abs(np.diff(x))) < 0.1


def test_a_plane_has_two_coordinates():
    with pytest.raises(ResultError, match="names 1"):
        points(strobes().assign_attrs(panel_variables="x1"))


# ---- densities


def test_a_density_of_many_points_is_an_image():
    many, few = density(states(MANY, 50)), density(states(FEW, 50))
    assert len(many.images) == 1
    assert not many.lines
    assert not few.images
    assert len(few.lines[0].get_xdata()) == 4 * 50


def test_random_starts_are_all_drawn():
    values = {name: (("b", "start", "strobe"), rng.normal(size=(4, 5, 6)), w, "1") for name, w in WORDS.items()}
    data = dataset({"b": (FEW, "coupling b")}, values, panel="density", panel_variables="x1")
    x, y = density(data).lines[0].get_data()
    assert np.array_equal(np.sort(y[x == 2.5]), np.sort(data["x1"].to_numpy()[1].ravel()))


def test_lanes_that_are_not_finite_are_drawn():
    density((states(MANY, 50) * np.nan).assign_attrs(states(MANY, 50).attrs)).figure.draw_without_rendering()


# ---- cascades


def test_doubling_points_are_marked_where_they_are():
    over = states(np.linspace(5.6, 5.45, 500), 50)
    ax = density(over, cascades=[doublings((5.7, 5.52, 5.489, 5.488))])
    marks = [line.get_xdata()[0] for line in ax.lines]
    assert marks == [5.52, 5.489, 5.488]
    labels = {text.get_text() for text in ax.texts}
    assert {"2 → 4", "4 → 8", "8 → 16"} <= labels
    ax = density(over, cascades=[doublings((5.52, 5.489, 5.488, 5.4878))])
    assert {"1 → 2", "2 → 4", "… 8 → 16"} <= {text.get_text() for text in ax.texts}


@pytest.mark.parametrize(
    "elsewhere", [doublings((0.8, 0.7), "drive", "drive at the doubling"), doublings((7.0, 6.9)), doublings((np.nan,))]
)
def test_doublings_that_are_not_in_the_picture_are_not_marked(elsewhere):
    """Along another axis, outside, or not found: then no legend speaks of them."""
    ax = density(states(MANY, 50), cascades=[elsewhere])
    assert not ax.lines
    assert ax.get_legend() is None


def test_a_cascade_names_its_doublings():
    ax = cascade(doublings((0.8452187, 0.79, np.nan), "drive", "parameter drive at the doubling"))
    assert [tick.get_text() for tick in ax.get_xticklabels()] == ["1 → 2\n0.84521870", "2 → 4\n0.79000000"]
    assert ax.get_xlabel() == r"doubling of the period, and its $\mathrm{drive}$ (dimensionless)"


def test_a_cascade_says_its_limits():
    """With as many digits as their errors leave; none where none is."""
    limits = {"delta_limit": 4.66921234, "delta_limit_error": 3.2e-5, "alpha": np.nan, "alpha_error": np.nan}
    words = [text.get_text() for text in cascade(doublings().assign(limits)).get_legend().get_texts()]
    assert "limit of δ = 4.66921 ± 3e-05" in words
    words = [text.get_text() for text in cascade(doublings()).get_legend().get_texts()]
    assert not [line for line in words if "limit" in line]


def test_a_cascade_without_a_doubling_is_drawn():
    cascade(doublings((np.nan, np.nan))).figure.draw_without_rendering()
    cascade(doublings((5.52,))).figure.draw_without_rendering()


# ---- curves


def test_curves_are_drawn_with_their_error():
    data = exponents(FEW, 2)
    ax = curves(data)
    order = np.argsort(FEW)
    assert len(ax.collections) == 2
    for k, band in enumerate(ax.collections):
        line = ax.lines[k + 1]
        assert np.array_equal(line.get_xdata(), FEW[order])
        assert np.array_equal(line.get_ydata(), data["exponents"].to_numpy()[order, k])
        edge = band.get_paths()[0].vertices
        for i in order:
            heights = edge[edge[:, 0] == FEW[i], 1]
            assert heights.min() == pytest.approx(data["exponents"].to_numpy()[i, k] - 0.1)
            assert heights.max() == pytest.approx(data["exponents"].to_numpy()[i, k] + 0.1)


@pytest.mark.parametrize(
    ("data", "label", "legend", "levels"),
    [
        (
            exponents(FEW, 3),
            "Lyapunov exponents $λ_k$ (1/time)",
            ["$λ_1$", "$λ_2$", "$λ_3$", "error of the exponents at 95 %"],
            [0],
        ),
        (exponents(FEW, 1), "largest Lyapunov exponent $λ_1$ (1/time)", ["error of the exponents at 95 %"], [0]),
        (growth_rates(FEW), "0–1 test, $K$ (dimensionless)", [], [0, 1]),
    ],
    ids=["three", "one", "another"],
)
def test_curves_and_bands_say_what_they_are(data, label, legend, levels):
    ax = curves(data)
    assert ax.get_ylabel() == label
    shown = ax.get_legend()
    assert [text.get_text() for text in shown.get_texts()] == legend if legend else shown is None
    assert [line.get_ydata()[0] for line in ax.lines[: len(levels)]] == levels


def test_curves_of_several_variables():
    """Each has its name; no band is drawn where no error is named."""
    axes = {"b": (FEW, "coupling b")}
    variables = {"loss": (("b",), FEW**2, "energy lost", "J"), "mu": (("b",), -FEW, "friction mu", "J")}
    ax = curves(dataset(axes, variables, panel="curves", panel_variables="loss mu", panel_label="energy"))
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["energy lost", r"$\mu$"]
    assert not ax.collections
    assert ax.get_ylabel() == "energy (J)"


# ---- integers and flags


def test_flags_are_counted():
    ax = flags(verdicts(MANY))
    assert [text.get_text() for text in ax.get_legend().get_texts()] == [
        "periodic: 250",
        "chaotic: 125",
        "undecided: 125",
    ]


def test_flags_of_any_values_and_meanings():
    """In any order, with words of more than one part; points whose value is no flag are left blank."""
    data = dataset(
        {"gain": ([1, 2, 3, 4], "gain")},
        {"state": (("gain",), [7, -1, 3, 5], "state of the valve", "1",
                   {"flag_values": np.array([7, 3, -1]), "flag_meanings": "wide_open shut stuck"})},
        panel="flags", panel_variables="state",
    )  # fmt: skip
    ax = flags(data)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["wide open: 1", "shut: 1", "stuck: 1"]
    assert ax.images[0].get_array().mask.tolist() == [[False, False, False, True]]
    assert ax.images[0].get_array()[0, :3].tolist() == [2, 0, 1]
    assert ax.get_ylabel() == "state of the valve"


def test_points_without_a_period_are_shown_as_such():
    ax = integers(periods(MANY))
    labels = [label.get_text() for label in ax.get_yticklabels()]
    assert labels == ["none", "1", "2", "4", "8", "16"]
    assert len(ax.lines[1].get_xdata()) == 100


@pytest.mark.parametrize(
    ("units", "gap"), [("periods of the forcing", "\n"), ("strobe periods", " "), ("crossings", " ")]
)
def test_periods_have_the_units_that_they_are_counted_in(units, gap):
    """In a second line where the label would be longer than the panel is high."""
    assert integers(periods(FEW, units)).get_ylabel() == f"least period{gap}({units})"


# ---- other names, and axes


def pendulum(panel, *more):
    """A user's system over `drive`: theta, theta_dot, (drive, *more)."""
    drive = np.linspace(0.5, 1.5, 4)
    words = {"theta": "angle theta", "theta_dot": "velocity theta_dot = dtheta/dt"}
    shape = (4, *(size for _, size in more))
    dims = ("drive", *(name for name, _ in more))
    variables = {name: (dims, rng.normal(size=shape), words[name], "1") for name in words}
    shown = "theta" if panel == "density" else "theta theta_dot"
    return dataset({"drive": (drive, "parameter drive")}, variables, panel=panel, panel_variables=shown)


@pytest.mark.parametrize("kind", ["trajectories", "points"])
def test_planes_of_a_system_with_other_names(kind):
    ax = PANELS[kind].draw(pendulum(kind, ("time", 16)), lane=1)
    assert ax.get_xlabel() == r"angle $\theta$ (dimensionless)"
    assert ax.get_ylabel() == r"velocity $\dot{\theta}$ (dimensionless)"
    assert ax.get_title() == r"(b) $\mathrm{drive}$ = 0.8333333333"
    ax.figure.draw_without_rendering()


@pytest.mark.parametrize("declared", ["", "drive", "drive mass"])
def test_a_density_of_a_system_with_other_names(declared):
    """The axis is one that is declared, or else the leading dimension."""
    data = pendulum("density", ("strobe", 6))
    ax = density(data.assign_attrs(axes=declared) if declared else data)
    assert ax.get_xlabel() == r"parameter $\mathrm{drive}$ (dimensionless)"
    assert ax.get_ylabel() == r"angle $\theta$ (dimensionless)"
    assert len(ax.lines[0].get_xdata()) == 4 * 6
    ax.figure.draw_without_rendering()


def test_one_number_a_lane_of_a_system_with_other_names():
    renamed = {"b": "spring_rate"}
    for draw, data in ((curves, growth_rates(FEW)), (integers, periods(FEW)), (flags, verdicts(FEW))):
        data = data.rename(renamed)
        data["spring_rate"].attrs["long_name"] = "rate of the spring spring_rate"
        ax = draw(data)
        assert ax.get_xlabel() == r"rate of the spring $\mathrm{spring\_rate}$ (dimensionless)"
        ax.figure.draw_without_rendering()


def test_lanes_of_two_axes():
    """Lanes are counted in C order of the declared axes, whatever the order of the dimensions."""
    data = pendulum("points", ("mass", 3), ("strobe", 5)).assign_coords(mass=[1.0, 2.0, 3.0])
    data = data.assign_attrs(axes="drive mass").transpose("strobe", "mass", "drive")
    ax = points(data, lane=4)
    assert ax.get_title() == r"(e) $\mathrm{drive}$ = 0.8333333333, $\mathrm{mass}$ = 2"
    chosen = data.isel(drive=1, mass=1)
    assert np.array_equal(ax.lines[0].get_xydata(), np.column_stack([chosen["theta"], chosen["theta_dot"]]))


def test_a_coordinate_that_rests_but_for_rounding():
    """As that of a section is: its axis has a range by the size of the other one."""
    data = pendulum("points", ("mass", 3), ("strobe", 5)).assign_coords(mass=[1.0, 2.0, 3.0])
    data = data.assign_attrs(axes="drive mass")
    data["theta"] = data["theta"].copy(data=np.full(data["theta"].shape, 3e-17))
    ax = points(data, lane=4)
    low, high = ax.get_xlim()
    assert high - low == pytest.approx(0.1 * np.abs(ax.dataLim.intervaly).max())
    assert low == pytest.approx(-high)


def test_a_panel_over_one_axis_at_a_point_of_another():
    data = pendulum("density", ("mass", 3), ("strobe", 5)).assign_coords(mass=[1.0, 2.0, 3.0])
    data = data.assign_attrs(axes="drive mass")
    with pytest.raises(ResultError, match="over one axis, not over drive and mass"):
        density(data)
    at_point, of_one = density(data.isel(mass=1)), density(data.isel(mass=slice(1, 2)))
    for ax in (at_point, of_one):
        assert ax.get_title("left") == r"$\mathrm{mass}$ = 2"
        assert np.array_equal(ax.lines[0].get_ydata(), data["theta"].isel(mass=1).to_numpy().ravel())
    across = density(data.isel(drive=[2]))
    assert across.get_title("left") == r"$\mathrm{drive}$ = 1.166666667"
    assert np.array_equal(across.lines[0].get_ydata(), data["theta"].isel(drive=2).to_numpy().ravel())


@pytest.mark.parametrize("name", ["x1", ""])
def test_a_missing_variable_is_named(name):
    data = states(FEW, 5).drop_vars("x1").assign_attrs(panel_variables=name)
    with pytest.raises(ResultError, match="no variable x1" if name else "names nothing"):
        density(data)


# ---- branches


def test_branches_are_solid_where_they_attract():
    """Each stretch once, to the point where it changes; a point of the orbit a line; what is beyond the end is not drawn."""
    data = cascade_branches()
    ax = branches(data)
    solid, dashed = ([line for line in ax.lines if (line.get_linestyle() == "-") == which] for which in (True, False))
    assert len(solid) == len(dashed) == 2
    stable, b = data["stable"].to_numpy(), data["b"].to_numpy()
    for k, (here, there) in enumerate(zip(solid, dashed, strict=True)):
        x = here.get_xdata()
        assert np.nanmin(x) == b[k][stable[k] == 1].min()
        assert np.nanmax(there.get_xdata()) == np.nanmax(b[k])
        assert np.nanmin(there.get_xdata()) == pytest.approx(np.nanmax(x), abs=0.04)  # one step of the branch
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["period 1", "period 2"]


def test_branches_change_where_their_bifurcation_is():
    """With the doublings given, solid ends and dashed begins in them, to the last digit, on every point of the orbit."""
    marks_of = cascade_marks().assign(branch=("bifurcation", np.array([0, 1, 0])))
    ax = branches(cascade_branches(), marks=[marks_of])
    lines = [line for line in ax.lines if len(line.get_xdata()) > 10]
    solid, dashed = ([line for line in lines if (line.get_linestyle() == "-") == which] for which in (True, False))
    for here, there, b in zip(solid, dashed, (3.0, 1 + np.sqrt(6)), strict=True):
        assert np.nanmax(here.get_xdata()) == np.nanmin(there.get_xdata()) == b
        tips = [line.get_ydata()[line.get_xdata() == b] for line in (here, there)]
        assert np.array_equal(*tips)
    assert np.sort(tips[0]) == pytest.approx([0.4399, 0.8499])


def test_equilibria_are_drawn():
    """Their period is 0, and each has one point, the first; in a column the legend is above."""
    data = cascade_branches().isel(branch=[0])
    data["period"][:] = 0
    ax = branches(data, Figure(figsize=(3.4, 2.6), layout="constrained").subplots())
    drawn = np.concatenate([line.get_xydata() for line in ax.lines])
    assert len(np.unique(drawn[np.isfinite(drawn[:, 0])], axis=0)) == 40
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["equilibria"]
    assert ax.get_legend().get_title().get_text() == "solid: stable, dashed: unstable"


def test_marks_are_on_branches_and_open_where_subcritical():
    ax = marks(cascade_marks())
    fold, doubling = ax.lines
    assert fold.get_label() == "fold, subcritical"
    assert fold.get_markerfacecolor() == "white"
    assert sorted(doubling.get_xdata()) == pytest.approx([3.0, 3.0, 1 + np.sqrt(6), 1 + np.sqrt(6)])


def test_curves_of_bifurcations_are_named_and_drawn_over_charts():
    """A colour a kind, a dash a period; a chart over the same axes has them in place of a panel of their own."""
    ax = bifurcation_curves(cusp_curves())
    named = [text.get_text() for text in ax.get_legend().get_texts()]
    assert named == ["fold, period 1", "period doubling, period 2"]
    assert [note.get_text() for note in ax.texts] == ["CP"]

    fold, doubling = (line for line in ax.lines if len(line.get_xdata()) > 1)
    assert fold.get_color() != doubling.get_color()
    assert fold.get_linestyle() != doubling.get_linestyle()
    axes = {name: (np.linspace(-0.5, 0.5, 9), f"{words} {name}") for name, words in (("p", "push"), ("q", "stiffness"))}
    chart = dataset(
        axes, {"period": (("p", "q"), np.ones((9, 9), int), "period", "1")}, panel="integers", panel_variables="period"
    )
    drawing = figure(tree({"period": chart, "curves": cusp_curves()}, axes="p q"))
    [ax] = [ax for ax in drawing.axes if ax.get_xlabel().startswith("push")]
    assert sum(len(line.get_xdata()) == 31 for line in ax.lines) == 4  # two curves, with a white edge each


@pytest.mark.parametrize(
    ("group", "made", "dims"),
    [("curves", cusp_curves, ("curve", "point")), ("codimension_two", cusp_point, ("codimension_two",))],
)
def test_a_parameter_named_t_is_no_time(group, made, dims):
    """Both parameters of curves are on the axes, whatever they are called."""
    data = made()
    data = data.rename({name: name.replace("q", "t") for name in data.data_vars if name.split("_")[-1] == "q"})
    data = data.assign({f"{name}_error": (dims, np.zeros(data[name].shape)) for name in ("p", "t")})
    data = describe(group, data.drop_attrs(deep=False))
    assert data.attrs["panel_variables"] == "p t"
    ax = PANELS[data.attrs["panel"]].draw(data)
    assert [ax.get_xlabel()[:4], ax.get_ylabel()[:9]] == ["push", "stiffness"]


def test_branches_over_a_parameter_named_t():
    data = cascade_branches().rename(b="t").drop_attrs(deep=False)
    assert describe("branches", data).attrs["along"] == "t"


# ---- windows


def test_branches_of_tori():
    """Solid where they attract and dashed elsewhere, without a gap between, and a triangle where one is born."""
    ax = torus_branches(torus_rows())
    solid, dashed, birth, *other = ax.lines
    assert (solid.get_linestyle(), dashed.get_linestyle(), birth.get_marker()) == ("-", "--", "^")
    assert (np.nanmin(solid.get_ydata()), np.nanmax(dashed.get_ydata())) == pytest.approx((0.35, 0.35))
    assert birth.get_xydata().tolist() == [[0.0, 0.2]]
    assert len(other) == 1  # the second attracts all along, and begins at a lane
    assert [text.get_text() for text in ax.get_legend().get_texts()] == [
        "of an orbit of period 1",
        "of an orbit of period 2",
    ]


def test_windows_are_bars_of_their_period():
    """Dark as far as orbits attract, pale as far as doublings go; where an end is not known, a lane stands for it."""
    ax = windows(window_rows())
    extents = [np.round(bar.get_datalim(ax.transData).intervalx, 4).tolist() for bar in ax.collections]
    assert extents == [[2.0, 3.5699], [2.0, 3.0], [3.8284, 3.8568], [3.8284, 3.8415], [3.7382, 3.743], [3.7382, 3.743]]
    marks = {line.get_label(): line.get_xdata().tolist() for line in ax.lines}
    assert marks == {"fold": [1 + np.sqrt(8), 3.738173], "period doubling": [3.0, 3.841499], "crisis": [3.8568]}


def test_windows_are_shaded_below_strobe_points():
    over = states(np.linspace(2.0, 4.0, 400), 50)
    shaded = len(density(over, spans=[window_rows()]).patches) - len(density(over).patches)
    assert shaded == 3
    elsewhere = window_rows().rename(b="d").assign_attrs(along="d")
    assert len(density(over, spans=[elsewhere]).patches) == len(density(over).patches)
