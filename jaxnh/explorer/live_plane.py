"""Planes computed on demand: few lanes for a short time first, then more and more of them in full."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping

import numpy as np
import xarray as xr

from jaxnh.engine.executor.lanes import TILE
from jaxnh.engine.experiment import Experiment
from jaxnh.engine.progress import Progress
from jaxnh.engine.session import Session
from jaxnh.exceptions import InputError
from jaxnh.explorer import batch
from jaxnh.explorer.lattice import Lattice, Places, blocks
from jaxnh.explorer.quantities import BASINS, OF_LANES, Options, analyses_of, shortened
from jaxnh.explorer.raster import plane_raster
from jaxnh.explorer.sessions import CalibratedSession, Sessions, goes_with
from jaxnh.explorer.source import LaneReport, Picture, axis_title
from jaxnh.explorer.view import View
from jaxnh.plotting.panels import pixels_of

_LANE_COLUMNS = 5  # columns of a diagram that one of a plane is as wide as
_ASPECT = 0.75  # rows a column
_LARGEST_STEP = 16
_PASS_SECONDS = 3.0
"""That a block of lanes is meant to take. Half a second of it, or more, is the same for any number of lanes, as a few
chaotic ones take as long as a tile of them: twice as many lanes take one and a half times as long, at most."""
_WORDS = {
    "lyapunov": "largest Lyapunov exponent",
    "period": "least period",
    "verdict": "verdict",
    "chaos01": "0–1 test K",
    BASINS: "attractor",
}


class LivePlane:
    """A plane of two axes of an experiment; as `Source`. All that computes is called in one thread."""

    computes = True
    overlays: Mapping[str, xr.Dataset] = {}

    def __init__(self, experiment: Experiment, progress: Progress, columns: int) -> None:
        """Nothing is computed yet.

        Args:
            experiment: two axes of it have two values or more; those after them stay at their first values.
            progress: of its sessions.
            columns: of a diagram as wide as the plane.

        Raises:
            InputError: it asks for basins of random starts, or no quantity goes with its system.
        """
        axes = [axis for axis in experiment.axes if len(axis.values) > 1][:2]
        own = batch.content_of(experiment)["analyses"] or {}
        asked = [name for name in (*OF_LANES, BASINS) if name in own]
        if (own.get(BASINS) or {}).get("n_starts"):
            asked.remove(BASINS)
            if not asked:
                raise InputError(
                    f"{experiment.label}: analyses.basins.n_starts: explore shows basins over start states, a lane "
                    "each; of random starts jaxnh sweep and jaxnh plot show the shares"
                )
        offered = [name for name in dict.fromkeys((*asked, *OF_LANES)) if goes_with(experiment, name, own.get(name))]
        if not offered:
            raise InputError(
                f"{experiment.label}: analyses: over two axes explore shows {', '.join(_WORDS)}; none goes with this"
            )
        self.sessions = Sessions(experiment, axes, offered, progress)
        self.parameters = self.sessions.parameters
        self.system_text = experiment.user_file.text if experiment.user_file else ""
        self.title = experiment.title or experiment.label
        self.axis_words = {axis.name: axis_title(axis.long_name, axis.units) for axis in axes}
        self.variables = {name: _WORDS[name] for name in offered}
        self._notes = (
            () if asked else (f"the config asks for {', '.join(own)}; over two axes explore shows these quantities",)
        )
        self._rows = any(axis.kind == "shared" for axis in axes)  # lanes of other values of it are run by themselves
        across, up = axes
        width = columns // _LANE_COLUMNS
        self.first = View(
            across.name,
            *self.sessions.ends[across.name],
            offered[0],
            self.sessions.ends[up.name],
            up.name,
            columns=width,
            rows=int(_ASPECT * width),
        )
        self._most: dict[tuple[int, str], int] = {}  # lanes of the next block, by session and quantity
        self._basins: tuple[View, Mapping[str, xr.Dataset]] | None = None  # the last ones of which all lanes are known

    def passes(self, view: View) -> Iterator[Picture]:
        """Pictures of a view: a coarse one, then all of its lanes, some at a time."""
        known, analyses = self.sessions.of(view), analyses_of(view.variable, self.sessions.own)
        lattice, step = Lattice(view, self.sessions.dims), self._step(view, known)
        if view.variable != BASINS:  # which take as long for a short time
            session = known.few if self._rows else known.session
            [places] = blocks((view.columns, view.rows), step, lambda: view.columns * view.rows, first=True)
            groups = self._computed(view, session, shortened(analyses), places)
            words = f"coarse: {len(places[0]):,} × {len(places[1]):,} lanes, for a short time"
            yield self._picture(view, known, lattice, groups, places, step, words)
        total, done, level = view.columns * view.rows, 0, step
        while level:
            for places in self._blocks(view, known, level, first=level == step):
                began, lanes = time.perf_counter(), len(places[0]) * len(places[1])
                groups = self._computed(view, known.session, analyses, places)
                self._adapt(view, known.session, lanes, time.perf_counter() - began)
                done = lanes if view.variable == BASINS else done + lanes
                words = f"{done:,} of {total:,} lanes; the others have what a neighbour has"
                if whole := done == total:
                    words = f"{view.columns:,} × {view.rows:,} lanes"
                yield self._picture(view, known, lattice, groups, places, level, words, whole=whole)
            level //= 2

    def lane(self, view: View, where: Mapping[str, float]) -> Iterator[LaneReport]:
        """Compute the report of a lane; where basins are known, with its attractor."""
        known = dict(self._basins[1]) if self._basins and self._basins[0] == view else {}
        if known:
            at = {self.sessions.dims[name]: value for name, value in where.items()}
            known[BASINS] = known[BASINS].sel(at, method="nearest")
        for report in self.sessions.lane(view, where):
            yield report._replace(groups={**known, **report.groups})

    def batch_text(self, view: View) -> str:
        """The YAML of a batch job that computes a view again."""
        return self.sessions.batch_text(view, analyses_of(view.variable, self.sessions.own), self.title)

    # ---- how

    def _blocks(
        self, view: View, known: CalibratedSession, step: int, *, first: bool
    ) -> Iterator[tuple[Places, Places]]:
        """Places of the lanes of a level, as many at a time as a pass has time for; of basins all at once."""
        shape = (view.columns, view.rows)
        if view.variable == BASINS:
            return blocks(shape, step, lambda: view.columns * view.rows, first=True)
        return blocks(shape, step, lambda: self._lanes_of_a_block(view, known.session), first=first)

    def _lanes_of_a_block(self, view: View, session: Session) -> int:
        """Lanes of the next block, at first those that all cores compute in the time of one."""
        return self._most.get((id(session), view.variable), TILE * session.devices)

    def _adapt(self, view: View, session: Session, lanes: int, seconds: float) -> None:
        """Have twice as many lanes in a block where that fits, half as many where it took too long."""
        most = self._lanes_of_a_block(view, session)
        if 1.5 * seconds < _PASS_SECONDS:
            most = max(most, 2 * lanes)
        elif seconds > 2.0 * _PASS_SECONDS:
            most = max(TILE * session.devices, lanes // 2)
        self._most[id(session), view.variable] = most

    def _computed(
        self, view: View, session: Session, analyses: Options, places: tuple[Places, Places]
    ) -> dict[str, xr.Dataset]:
        """Groups of the lanes at a product of places along both axes."""
        at = {name: values[place] for (name, values), place in zip(view.grid().items(), places, strict=True)}
        return session.groups(analyses, **at, **self.sessions.changed_parameters(view))

    def _step(self, view: View, known: CalibratedSession) -> int:
        """Step between lanes of a coarse picture: they fill one tile on each device, which takes the least time."""
        lanes, step = TILE * known.session.devices, 1
        while step < _LARGEST_STEP and -(-view.columns // step) * -(-view.rows // step) > lanes:
            step *= 2
        return step

    def _picture(
        self,
        view: View,
        known: CalibratedSession,
        lattice: Lattice,
        groups: Mapping[str, xr.Dataset],
        places: tuple[Places, Places],
        step: int,
        words: str,
        *,
        whole: bool = False,
    ) -> Picture:
        lattice.put(groups[view.variable], places, step)
        shown = {view.variable: lattice.dataset(), **{name: groups[name] for name in ("attractors",) if name in groups}}
        if whole and view.variable == BASINS:
            self._basins = view, shown
        pixels = pixels_of(view.variable, shown)
        failed = int(np.sum(np.ma.getmaskarray(pixels.places)))
        words += f"; {failed:,} failed" if failed else ""
        data = xr.DataTree.from_dict(shown) if whole else None  # pyright: ignore[reportUnknownMemberType]
        return Picture(plane_raster(pixels), data, words, (*self._notes, *self.sessions.notes(view, known)), pixels)
