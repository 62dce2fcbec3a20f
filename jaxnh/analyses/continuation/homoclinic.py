"""Curves of homoclinic and heteroclinic orbits over two parameters, with the saddles' eigenvalues along them.

At some values of the second axis manifolds of saddles are followed along the first (`connection_seeds`); others come
from cycles of large period and from Bogdanov–Takens points. From each orbit that Newton confirms its curve goes to both
ends (`orbits.collocation.connections`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from jaxnh.analyses.base import (
    Analysis,
    Entry,
    OptionError,
    Setting,
    SweepLanes,
    SweepReduction,
    Table,
    check_names,
    flag,
    number_lanes,
    variable,
)
from jaxnh.analyses.batch import Axis, LaneBatch, LaneRunner, rate_attrs
from jaxnh.analyses.continuation.bogdanov_takens_connections import (
    BogdanovTakensStart,
    bogdanov_takens_starts,
    path_size,
)
from jaxnh.analyses.continuation.connection_seeds import ConnectionSeed, Shooting, connection_seeds, saddle_chains
from jaxnh.analyses.continuation.cycle_connections import seeds_from_cycles
from jaxnh.analyses.continuation.equilibria import equilibria_in_a_box
from jaxnh.analyses.continuation.families import check_plane, lanes_along, plane_axes, step_control, values_searched
from jaxnh.analyses.continuation.tables import special_kinds, special_values
from jaxnh.analyses.options.orbits import HomoclinicOptions
from jaxnh.analyses.periodic.flow_cycles import flow_problem, no_collocation
from jaxnh.analyses.price import Price, map_alone
from jaxnh.analyses.random_starts import check_box
from jaxnh.analyses.table_arrays import longest, padded, real_and_imaginary
from jaxnh.orbits.bifurcations.connection_points import (
    BOGDANOV_TAKENS,
    POINTS,
    TYPES,
    SpecialConnection,
    leading,
    special_connections,
)
from jaxnh.orbits.collocation.connection_joins import is_on_curve, join_connections
from jaxnh.orbits.collocation.connection_meshes import Connection, refined
from jaxnh.orbits.collocation.connections import (
    ConnectionCurve,
    VanishingPoint,
    connection_near,
    follow_connections,
)
from jaxnh.orbits.collocation.equations import Problem
from jaxnh.orbits.collocation.paths import values_at
from jaxnh.orbits.continuation import paths
from jaxnh.orbits.continuation.paths import ENDS

KINDS = ("homoclinic", "heteroclinic")
"""Orbits by number: from a saddle to itself, or to another one."""

_OWN_NAMES = (
    "curve", "point", "codimension_two", "eigenvalue", "part", "kind", "begins", "ends", "eigenvalues",
    "saddle_quantity", "saddle_type", "shilnikov", "codimension_two_kind", "codimension_two_curve",
)  # fmt: skip
_SAMPLES = 129  # of an orbit, close together where its mesh is


class FollowedConnections(NamedTuple):
    """A curve with errors.

    Attributes:
        points: orbits on fine meshes, in order.
        errors: of both parameters, (k, 2).
        ends: numbers in `ENDS`.
        special: points of codimension two.
    """

    points: list[Connection]
    errors: Float[np.ndarray, "k 2"]
    ends: tuple[int, int]
    special: list[SpecialConnection]


def numbers(options: HomoclinicOptions) -> int:
    """Numbers that a lane leaves."""
    return 1


def check(options: HomoclinicOptions, setting: Setting) -> None:
    """Check the axes, names, and that the flow has isolated equilibria and a box to look for them."""
    if why := no_collocation(setting.flow):
        raise OptionError(why)
    if not setting.autonomous:
        raise OptionError("a flow with a clock has no equilibria, which homoclinic orbits connect")
    setting = check_plane("homoclinic orbits", setting)
    if not options.box:
        raise OptionError("needs a box to draw the starts of Newton for saddles from", "box")
    check_box(options.box, setting)
    check_names("homoclinic", {*_OWN_NAMES, *(f"{axis.name}_error" for axis in setting.axes)}, setting)


def whole(
    options: HomoclinicOptions, sweep: SweepLanes, lanes: LaneRunner, data: xr.Dataset
) -> Mapping[str, xr.Dataset]:
    """The groups `homoclinic` and `connecting_orbits`."""
    sweep = sweep._replace(axes=plane_axes(sweep.axes))
    (first, second), [(_, row)] = sweep.axes, sweep.rows
    low, high = (np.array([float(end(axis.values)) for axis in sweep.axes]) for end in (np.min, np.max))
    names, curves = (first.name, second.name), list[tuple[Problem, ConnectionCurve]]()
    values = values_searched(second, options.n_values).tolist()
    batches = [lanes_along(row, first, second, value) for value in values]
    starts = bogdanov_takens_starts(batches, lanes, options, names, (low, high)) if options.bogdanov_takens else []
    plan = _Plan(options, (low, high), [start.vanishing() for start in starts], curves)
    with lanes.stage(f"homoclinic: curves from {len(starts)} Bogdanov–Takens points", 0):
        for start in starts:
            plan.follow(start.problem, start.orbit)
    for value, on_section in zip(values, batches, strict=True):
        batch = on_section.without_section()
        with lanes.stage(f"homoclinic: saddles and their manifolds at {second.name} = {value:g}", 0):
            seeds = _seeds(options, batch, lanes, names, high - low, value)
        if options.cycles:
            seeds += seeds_from_cycles(on_section, lanes, options, names, (low, high), value)
        with lanes.stage(f"homoclinic: curves from {len(seeds)} orbits at {second.name} = {value:g}", 0):
            for seed in seeds:
                problem = flow_problem(batch, lanes, path_size(seed.guess.path.ends[0]), names, high - low)
                plan.follow(problem, connection_near(problem, seed.guess, seed.departure, seed.arrival))
    with lanes.stage(f"homoclinic: errors of {len(curves)}", 0):
        followed = [_with_errors(curve, starts) for _, curve in curves]
    row, data = row.without_section(), _dataset(row.without_section(), sweep.axes, followed)
    warnings = [*_no_curve(names, followed), *_no_start(options, names, values, starts)]
    data.attrs |= {"warnings": "\n".join(warnings)} if warnings else {}
    return {"homoclinic": data, "connecting_orbits": _orbits(row, followed)}


def _no_curve(names: tuple[str, str], curves: Sequence[FollowedConnections]) -> list[str]:
    """Say that there is no curve."""
    return [] if curves else [f"homoclinic: there is no orbit to follow over {' and '.join(names)}"]


def _no_start(
    options: HomoclinicOptions, names: tuple[str, str], values: list[float], starts: Sequence[BogdanovTakensStart]
) -> list[str]:
    """Say where no curve has been begun at a Bogdanov–Takens point, and what was tried."""
    if options.bogdanov_takens and not starts:
        return [
            f"homoclinic: there is no Bogdanov–Takens point to begin at over {' and '.join(names)}; looked along "
            f"curves of folds and Hopf points of equilibria from {options.n_starts} starts at {len(values)} "
            f"value{'s' * (len(values) > 1)} of {names[1]}"
        ]
    lost = [start for start in starts if start.orbit is None]
    places = [np.where(np.abs(start.values) <= start.error, 0.0, start.values).tolist() for start in lost]
    return [
        f"homoclinic: no curve begins at the Bogdanov–Takens point at {names[0]} = {place[0]:.9g}, {names[1]} = "
        f"{place[1]:.9g}: {start.tried}"
        for start, place in zip(lost, places, strict=True)
    ]


def _seeds(
    options: HomoclinicOptions,
    batch: LaneBatch,
    lanes: LaneRunner,
    names: tuple[str, str],
    widths: np.ndarray,
    value: float,
) -> list[ConnectionSeed]:
    """Guesses of connecting orbits at a value of the second parameter."""
    u, at, size = equilibria_in_a_box(batch, lanes, options.n_starts, options.seed, options.box)
    values = np.unique(batch.first_axis.values)
    problem = flow_problem(batch, lanes, size, names, widths)
    shooting = Shooting(batch, lanes, problem, value, options.duration, options.pulses)
    chains = saddle_chains(shooting, values, [u[at == number] for number in values])
    return list(connection_seeds(shooting, values, chains))


class _Plan(NamedTuple):
    """Curves so far, each with the problem in sizes of its first orbit, and how more are followed.

    Attributes:
        options: of the analysis.
        ends: of the ranges of both parameters, the lower ones first.
        vanishing: points at which curves end.
        curves: those that are known.
    """

    options: HomoclinicOptions
    ends: tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]]
    vanishing: Sequence[VanishingPoint]
    curves: list[tuple[Problem, ConnectionCurve]]

    def follow(self, problem: Problem | None, start: Connection | None) -> None:
        """Add the curve of an orbit, unless there is none or its curve is known; cut ones are joined to it."""
        if problem is None or start is None:
            return
        if np.any(start.values < self.ends[0]) or np.any(start.values > self.ends[1]):
            return
        if any(is_on_curve(problem, curve, start) for _, curve in self.curves):
            return
        whole = follow_connections(problem, start, *self.ends, step_control(self.options), self.vanishing)
        apart = list[tuple[Problem, ConnectionCurve]]()
        for own, other in self.curves:
            joined = join_connections(problem, other, whole)
            whole, more = (whole, [(own, other)]) if joined is None else (joined, [])
            apart += more
        self.curves[:] = [*apart, (problem, whole)]


def _with_errors(curve: ConnectionCurve, starts: Sequence[BogdanovTakensStart]) -> FollowedConnections:
    """The orbits of a curve on finer meshes, with the errors of their parameters; NaN where Newton confirms none."""
    # Each stretch begins with the orbit that the one before ends with.
    coarse = [
        (stretch.problem, point) for k, stretch in enumerate(curve.stretches) for point in stretch.points[min(k, 1) :]
    ]
    points, errors = list[Connection](), list[np.ndarray]()
    for problem, point in coarse:
        finer = refined(problem, point)
        points.append(point if finer is None else finer.orbit)
        errors.append(np.full(2, np.nan) if finer is None else finer.error)
    homoclinic = _kind(points[0]) == 0 if points else False
    special = [member for _, member in special_connections(curve)] if homoclinic else []
    first, last = (
        [_vanished(starts, points[k])] if points and curve.ends[k] == paths.BOGDANOV_TAKENS else [] for k in (0, -1)
    )
    return FollowedConnections(points, np.reshape(errors, (-1, 2)), curve.ends, [*first, *special, *last])


def _vanished(starts: Sequence[BogdanovTakensStart], point: Connection) -> SpecialConnection:
    """The Bogdanov–Takens point that a curve ends at with an orbit."""
    states = point.solution.path.ends[0]
    nearest = min(starts, key=lambda start: float(np.abs((states - start.state) / np.ptp(states, axis=0)).max()))
    return SpecialConnection(BOGDANOV_TAKENS, nearest.values, nearest.error, point)


def _kind(point: Connection) -> int:
    """Number in `KINDS`: eigenvalues are those of the same saddle, or of one whole turns further."""
    same = np.allclose(point.departure.jacobian, point.arrival.jacobian, rtol=1e-9, atol=1e-12)
    return 0 if same else 1


# ---- the dataset


def _dataset(batch: LaneBatch, axes: Sequence[Axis], curves: Sequence[FollowedConnections]) -> xr.Dataset:
    """Variables over (curve, point), filled up with NaN, and over (codimension_two,)."""
    length, d = longest([curve.points for curve in curves]), batch.chart.dimension

    def along(number_of, *more: int, fill: float = np.nan) -> np.ndarray:
        rows = [[number_of(point) for point in curve.points] for curve in curves]
        return padded(rows, (length, *more), fill)

    dims, rate = ("curve", "point"), rate_attrs(batch.flow)
    columns: dict[str, Entry] = {}
    for k, axis in enumerate(axes):
        columns[axis.name] = variable(dims, along(lambda point, k=k: point.values[k]), axis.long_name, axis.units)
        words = f"error of {axis.name}: a point of the exact curve is as near in both parameters"
        columns[f"{axis.name}_error"] = variable(
            dims, padded([c.errors[:, k] for c in curves], (length,)), words, axis.units
        )
    columns |= _saddle_columns(batch, dims, along)
    eigenvalues = along(lambda point: real_and_imaginary(point.departure.eigenvalues), d, 2)
    quantity = along(lambda point: leading(point.departure).saddle_quantity)
    kinds = along(lambda point: leading(point.departure).kind, fill=-1.0)
    shilnikov = along(lambda point: float(leading(point.departure).shilnikov), fill=-1.0)
    filled = {
        **columns,
        "kind": flag("curve", [_kind(curve.points[0]) for curve in curves], "kind of orbit", KINDS),
        "eigenvalues": variable(
            (*dims, "eigenvalue", "part"), eigenvalues, "eigenvalues of the saddle, real and imaginary part", **rate
        ),
        "saddle_quantity": variable(dims, quantity, "sum of the real parts of both leading eigenvalues", **rate),
        "saddle_type": flag(dims, kinds, "kind of the saddle by its leading eigenvalues", ("none", *TYPES), -1),
        "shilnikov": flag(
            dims, shilnikov, "whether there are infinitely many cycles nearby by Shilnikov", ("none", "no", "yes"), -1
        ),
        "begins": flag("curve", [curve.ends[0] for curve in curves], "why the curve begins there", ENDS),
        "ends": flag("curve", [curve.ends[1] for curve in curves], "why the curve ends there", ENDS),
        **_special_columns(axes, curves),
    }
    names = " ".join(axis.name for axis in axes)
    return xr.Dataset(filled, attrs={"over": names})


def _orbits(batch: LaneBatch, curves: Sequence[FollowedConnections]) -> xr.Dataset:
    """Variables over (curve, point, sample): times and states of the orbits, filled up with NaN."""
    shape = len(curves), max((len(curve.points) for curve in curves), default=0), _SAMPLES
    times, states = np.full(shape, np.nan), np.full((*shape, batch.chart.dimension), np.nan)
    for k, curve in enumerate(curves):
        for i, point in enumerate(curve.points):
            path = point.solution.path
            at = np.interp(np.linspace(0.0, 1.0, _SAMPLES), np.linspace(0.0, 1.0, path.mesh.shape[1]), path.mesh[0])
            times[k, i], states[k, i] = point.solution.duration[0] * at, values_at(path, at[None])[0]
    dims, labels = ("curve", "point", "sample"), batch.flow.readout.labels
    columns = {"t": variable(dims, times, "time from the first state near the saddle", labels.units["t"])}
    for k, name in enumerate(batch.flow.coordinates):
        columns[f"{name}_points"] = variable(dims, states[..., k], labels.long_names[name], labels.units[name])
    return xr.Dataset(columns)


def _saddle_columns(batch: LaneBatch, dims: tuple[str, str], along) -> dict[str, Entry]:
    """States of the saddles that orbits leave and come to."""
    columns: dict[str, Entry] = {}
    for k, name in enumerate(batch.flow.coordinates):
        words, units = batch.flow.readout.labels.long_names[name], batch.flow.readout.labels.units[name]
        for end in ("departure", "arrival"):
            state = along(lambda point, end=end, k=k: getattr(point, end).state[k])
            columns[f"{name}_{end}"] = variable(dims, state, f"{words} at the saddle of {end}", units)
    return columns


def _special_columns(axes: Sequence[Axis], curves: Sequence[FollowedConnections]) -> dict[str, Entry]:
    """Points of codimension two: kinds, numbers of their curves, and both parameters with errors."""
    special, before = [(k, point) for k, curve in enumerate(curves) for point in curve.special], "codimension_two_"
    columns = special_kinds(before, [point.kind for _, point in special], [k for k, _ in special], POINTS)
    for k, axis in enumerate(axes):
        words = f"{axis.long_name} at the point of codimension two"
        values, errors = [point.values[k] for _, point in special], [point.error[k] for _, point in special]
        columns |= special_values(f"{before}{axis.name}", axis, values, errors, words)
    return columns


def table(data: xr.Dataset, published: Mapping[str, np.ndarray], source: str) -> Table:
    """A row a curve."""
    first, second = str(data.attrs["over"]).split()
    rows = []
    for k in range(data.sizes["curve"]):
        curve = data.isel(curve=k)
        ranges = [f"{float(curve[name].min()):.9g} to {float(curve[name].max()):.9g}" for name in (first, second)]
        worst = max(float((curve[f"{name}_error"]).max()) for name in (first, second))
        special = [POINTS[int(kind)] for kind in data["codimension_two_kind"][data["codimension_two_curve"] == k]]
        rows.append((KINDS[int(curve["kind"])], *ranges, f"{worst:.1g}", ", ".join(special) or "–"))
    heads = ("orbit", first, second, "error", "points of codimension two")
    return Table("Homoclinic and heteroclinic orbits", heads, tuple(rows), left=(0, 4))


def price(options: HomoclinicOptions, batch: LaneBatch) -> Price:
    """Return the price: orbits are boundary-value problems, whose algebra is on the host."""
    return Price(None, map_alone(batch), "not measured: rates of the flow at the points of meshes, and their algebra")


ANALYSIS = Analysis(
    "homoclinic",
    HomoclinicOptions,
    # a guess, as nobody knows how many saddles there are
    lambda options, lanes: 2.0 * options.n_values * lanes**0.5 * options.duration,
    number_lanes,  # only those at a few values of the second axis are looked at, once all are there
    whole=SweepReduction(("connecting_orbits",), whole),
    numbers=numbers,
    check=check,
    table=table,
    price=price,
    brief={"duration": 1, "n_values": 1, "n_starts": 1},
)
