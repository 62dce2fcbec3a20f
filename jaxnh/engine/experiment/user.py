"""Experiments of users' systems, each with the file that has been tried out."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from jaxtyping import Float
from pydantic import PrivateAttr

from jaxnh.config.config import Config, UserConfig, config_of
from jaxnh.config.user_system import UserSection
from jaxnh.engine.clocks import decides_clock, scales_time
from jaxnh.engine.experiment.base import Experiment
from jaxnh.engine.fitting import check_events
from jaxnh.engine.flows import section_of
from jaxnh.engine.start_states import admit_starts, check_starts
from jaxnh.maps.section import Section
from jaxnh.systems.flow import Flow
from jaxnh.systems.lagrangian import Lagrangian
from jaxnh.systems.level import on_level
from jaxnh.systems.state import State
from jaxnh.systems.user_file import UserFile, UserFlow


class UserExperiment(UserConfig, Experiment, frozen=True):
    """An experiment of a user's system."""

    _file: UserFile = PrivateAttr()

    @classmethod
    def _copied(cls, config: Config, user_file: UserFile | None) -> Self:
        assert isinstance(config, UserConfig)
        user_file = user_file or UserFile(config._path, config._user_text)
        if user_file.names != config._names:  # its text alone says less, or other than it does
            config = config_of(config._source, user_text=config._user_text, names=user_file.names)
        made = super()._copied(config, user_file)
        made._set_private(_file=user_file)
        return made

    def _try_out(self) -> None:
        check_starts(self.flow(), self.initial, self.sweep, self._file.integrals)
        if self._file.discrete:
            self.check_map()
        self.check_clock(not self.autonomous)
        check_events(self.flow(), self.accuracy.solver, self.precision)
        super()._try_out()

    def _flow(self, parameters: Mapping[str, float]) -> UserFlow:
        given = {**(self.initial.level or {}), **parameters}
        levels = {name: given[name] for name in self._levels if name in given}
        swept = {name: value for name, value in parameters.items() if name not in levels}
        flow = self._file.flow({**self._own_parameters(), **swept}, tuple(swept), in_periods=self._in_periods)
        return on_level(flow, levels, parameters)

    @functools.cached_property
    def _levels(self) -> tuple[str, ...]:
        """Integrals on whose levels motions are kept; where constraints come and go starts alone are put there."""
        return self._file.integrals if isinstance(self._file.flow(self._own_parameters()), Lagrangian) else ()

    @functools.cached_property
    def _in_periods(self) -> bool:
        """Tell whether time is over the period: an axis decides the period, and no result has a time."""
        untimed = all(options.untimed for options in self.analyses.options().values())
        swept = {name: grid.grid() for name, grid in self.sweep.grids.items() if name not in self._of_starts}
        return untimed and scales_time(self._file, self._own_parameters(), swept)

    def _is_shared(self, name: str, values: Float[np.ndarray, " n"], flow: Flow) -> bool:
        """Return whether the strobe period depends on a parameter, and time is not over the period."""
        known = self._in_periods or name in self._levels
        return not known and decides_clock(self._file, flow, name, values)

    def _admit_starts(
        self, flow: Flow, start: State, own: Mapping[str, Float[np.ndarray, " count"]], given: Mapping[str, Any]
    ) -> State:
        every = {**given, **own}
        levels = {name: every[name] for name in self._file.integrals if name in every}
        return admit_starts(flow, start, own, levels, project=self.initial.project)

    @property
    def _of_starts(self) -> tuple[str, ...]:
        return (*self.initial.known, *(name for name in self._file.integrals if name not in self._levels))

    @property
    def _section(self) -> UserSection:
        first = {"coordinate": self._file.coordinates[0]}
        return self.section or UserSection.model_validate(first, context=self._file.names)

    def _on_section(self, flow: Flow) -> Section:
        return section_of(self._section, self._file.coordinates, flow)

    @property
    def user_file(self) -> UserFile:
        """The user's file that the system is from."""
        return self._file

    def _own_parameters(self) -> dict[str, float]:
        """All parameters, with the file's defaults where the config says nothing."""
        return {**self._file.parameters, **self.system.parameters}

    def _content(self) -> dict[str, Any]:
        system = {**self._own_parameters(), "file": self._file.sha256}
        initial = {**self.initial.coordinates(), **({"project": True} if self.initial.project else {})}
        return {**super()._content(), "system": system, "initial": initial}

    def _parameters(self) -> dict[str, Any]:
        return {"file": self.system.file, **self._own_parameters(), **self.initial.coordinates()}
