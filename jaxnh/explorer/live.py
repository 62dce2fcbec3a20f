"""Diagrams computed on demand: coarse first, then in full."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool

from jaxnh.engine.executor.lanes import TILE
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.progress import Progress
from jaxnh.engine.session import Session
from jaxnh.exceptions import InputError
from jaxnh.explorer.live_plane import LivePlane
from jaxnh.explorer.raster import raster, values_of
from jaxnh.explorer.sessions import Sessions
from jaxnh.explorer.source import LaneReport, Picture, PictureSource, axis_title
from jaxnh.explorer.view import View

_COARSE_SECONDS = 0.15  # that a coarse picture may be computed in
_COARSE_STROBES = 32
_COARSE_TRANSIENTS = (16, 128)  # periods at least, and at most


def live(experiment: Experiment, progress: Progress, columns: int) -> PictureSource:
    """The plane of the first two axes of two values or more, or the diagram over the only one.

    Args:
        progress: of the sessions.
        columns: values of the axis in a diagram.

    Raises:
        InputError: there is no such axis, or no quantity for a plane.
    """
    long = [axis for axis in experiment.axes if len(axis.values) > 1]
    if not long:
        raise InputError(f"{experiment.label}: sweep: explore needs an axis of two values or more")
    return LiveDiagram(experiment, progress, columns) if len(long) == 1 else LivePlane(experiment, progress, columns)


class LiveDiagram:
    """The diagram of an experiment; as `PictureSource`. All that computes is called in one thread."""

    computes = True
    overlays: Mapping[str, xr.Dataset] = {}

    def __init__(self, experiment: Experiment, progress: Progress, columns: int) -> None:
        """Nothing is computed yet.

        Args:
            experiment: one axis of it has two values or more.
            progress: of its sessions.
            columns: values of the axis in a picture.
        """
        axis, flow = next(axis for axis in experiment.axes if len(axis.values) > 1), experiment.flow()
        self.sessions = Sessions(experiment, [axis], ["diagram"], progress)
        self.parameters = self.sessions.parameters
        self.system_text = experiment.user_file.text if experiment.user_file else ""
        options: Mapping[str, Any] = self.sessions.own.get("diagram") or {}
        self.title = experiment.title or experiment.label
        self._notes = (
            (f"states are not carried here: every value starts from the same state, not {options['start']} the axis",)
            if options.get("start", "fixed") != "fixed"
            else ()
        )
        self.first = View(
            axis.name,
            *self.sessions.ends[axis.name],
            flow.readout.labels.planes[0][0],
            transient=options.get("transient", 512),
            strobes=options.get("strobes", 128),
            columns=columns,
        )
        self.axis_words = {axis.name: axis_title(axis.long_name, axis.units)}
        self.variables = {
            name: axis_title(flow.readout.labels.long_names[name], flow.readout.labels.units[name])
            for name in flow.coordinates
        }
        self._seconds: dict[int, float] = {}  # a lane-period, by session

    def passes(self, view: View) -> Iterator[Picture]:
        """Pictures of a view: a coarse one, then its columns in full, some of them at a time."""
        moved, known = self.sessions.changed_parameters(view), self.sessions.of(view)
        values, notes = view.values(), (*self._notes, *self.sessions.notes(view, known))
        dim = self.sessions.dims[view.axis]
        every = max(1, -(-view.columns // (TILE * known.session.devices)))
        coarse = self._coarse_transient(known.session, view, len(values[::every]))
        strobes = min(_COARSE_STROBES, view.strobes)
        points, failed = np.full((len(values), view.strobes), np.nan), np.zeros(len(values), bool)
        if coarse + strobes < view.transient + view.strobes:
            rough = self._diagram(known.session, view, values[::every], moved, coarse, strobes)
            _, states = values_of(rough, dim, view.variable)
            points[:, :strobes] = np.repeat(states, every, axis=0)[: len(values)]
            words = f"coarse: {len(states):,} values, {strobes} strobes after {coarse} periods"
            words += _failures(np.any(~np.isfinite(states), axis=1))
            yield Picture(raster(values, points, view.window), None, words, notes)
        parts = []
        for k in range(every):
            parts.append(self._diagram(known.session, view, values[k::every], moved, view.transient, view.strobes))
            points[k::every] = values_of(parts[-1], dim, view.variable)[1]
            failed[k::every] = np.any(~np.isfinite(points[k::every]), axis=1)
            whole = xr.concat(parts, dim).sortby(dim) if k == every - 1 else None
            share = f"{view.columns:,} values" if whole is not None else f"{k + 1} of {every} parts refined"
            words = f"{share}, {view.strobes} strobes after {view.transient} periods{_failures(failed)}"
            yield Picture(raster(values, points, view.window), whole, words, notes)

    def lane(self, view: View, where: Mapping[str, float]) -> Iterator[LaneReport]:
        """Compute the facts of a lane."""
        return self.sessions.lane(view, where)

    def batch_text(self, view: View) -> str:
        """The YAML of a batch job that computes a view again."""
        options = {"transient": view.transient, "strobes": view.strobes}
        return self.sessions.batch_text(view, {"diagram": options}, self.title)

    # ---- how

    def _diagram(
        self, session: Session, view: View, values: np.ndarray, moved: Mapping[str, float], transient: int, strobes: int
    ) -> xr.Dataset:
        began = time.perf_counter()
        data = session.run("diagram", {"transient": transient, "strobes": strobes}, **{view.axis: values, **moved})
        each = (time.perf_counter() - began) / (len(values) * (transient + strobes))
        self._seconds[id(session)] = min(self._seconds.get(id(session), np.inf), each)
        return data

    def _coarse_transient(self, session: Session, view: View, lanes: int) -> int:
        """Periods before the strobes of a coarse picture, as many as there is time for."""
        least, most = _COARSE_TRANSIENTS
        each = self._seconds.get(id(session), np.inf)
        fits = int(_COARSE_SECONDS / (each * lanes)) - _COARSE_STROBES if np.isfinite(each) else most
        return min(view.transient, max(least, min(most, fits)))


def _failures(failed: Bool[np.ndarray, " columns"]) -> str:
    """Describe how many values have a state that is not finite; nothing where there are none."""
    return f"; {np.count_nonzero(failed):,} failed, their states are not finite" if failed.any() else ""
