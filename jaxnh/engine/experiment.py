"""An experiment: a config with its flow, its start states and its axes.

Keys of a config, and all checks that need no JAX, are in `config`.
"""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from pydantic import PrivateAttr
from pydantic_core import PydanticCustomError

from jaxnh.analyses.base import Analysis, Setting
from jaxnh.analyses.batch import Axis
from jaxnh.analyses.options.base import Options
from jaxnh.analyses.registry import ANALYSES
from jaxnh.config.config import Config, UserConfig, config_of, load_config
from jaxnh.config.messages import fault_of_rule
from jaxnh.config.particle import PoincareSection
from jaxnh.config.user_system import UserSection
from jaxnh.config.values import grid_of, without_values
from jaxnh.config.yaml_source import from_dict, from_text
from jaxnh.engine.clocks import decides_clock, scales_time
from jaxnh.engine.fitting import check_analyses, check_events, check_levels
from jaxnh.engine.flows import particle_flow, section_of
from jaxnh.engine.start_states import admit_starts, check_starts
from jaxnh.exceptions import InputError
from jaxnh.maps.section import System, begin
from jaxnh.systems.flow import Flow
from jaxnh.systems.lagrangian import Lagrangian
from jaxnh.systems.level import on_level
from jaxnh.systems.state import State
from jaxnh.systems.user_file import UserFile, UserFlow


class Experiment(Config):
    """A validated config; made by `load`, `Experiment.from_dict` or `Experiment.from_text`."""

    _filler: str = PrivateAttr(default="")

    # ---- how it is made

    def __init__(self, *arguments: Any, **content: Any) -> None:
        """Say how an experiment is made: not by hand."""
        raise InputError("an experiment is read by jaxnh.load, or made by Experiment.from_dict or Experiment.from_text")

    @classmethod
    def from_config(cls, config: Config, user_file: UserFile | None = None) -> Experiment:
        """The experiment of a config; its flow is made and checked against analyses and levels.

        Args:
            config: what is run.
            user_file: the user's file that it names, where it has been tried out before.

        Raises:
            ConfigError: as of `load`.
        """
        if isinstance(config, UserConfig):
            user_file = user_file or UserFile(config._path, config._user_text)
            if user_file.names != config._names:  # its text alone says less, or other than it does
                config = config_of(config._source, user_text=config._user_text, names=user_file.names)
        kind = UserExperiment if user_file else Experiment
        made = kind.model_construct(config.model_fields_set, **dict(config))
        for name in config.__private_attributes__:
            setattr(made, name, getattr(config, name))
        if isinstance(made, UserExperiment) and user_file:
            made._file = user_file
        try:
            with jax.enable_x64(True):  # a script may load a config before it has started a session
                made._try_out()
        except PydanticCustomError as broken:
            raise fault_of_rule(broken, config._source) from None
        return made

    def _try_out(self) -> None:
        """Check everything that needs the flow.

        Raises:
            ValueError: something does not go together; the rule names the key.
        """
        axes, requested = self.axes, self.requested()
        setting = Setting(
            self.flow(), self.autonomous, axes, self.precision, lambda value: self.flow({axes[0].name: value})
        )
        check_analyses(requested, setting)
        if self.levels:
            check_levels(self.levels, {name: grid.size for name, grid in self.sweep.grids.items()}, requested)

    @classmethod
    def from_dict(cls, content: Mapping[str, Any], overrides: Sequence[str] = ()) -> Experiment:
        """The experiment of a dict with the content of a YAML file; paths are relative to the working folder.

        Args:
            content: mappings, lists, text, numbers and booleans; NumPy's arrays and numbers as well.
            overrides: KEY=VALUE, as of `load`.

        Raises:
            ConfigError: one line, `experiment: KEY: what is wrong`.
        """
        return cls.from_config(config_of(from_dict(content, overrides)))

    @classmethod
    def from_text(cls, text: str, user_text: str | None = None) -> Experiment:
        """The experiment of the text of a YAML file.

        Args:
            text: such as `Experiment.text` of another one.
            user_text: what the user's file says that the config names, in place of reading it.

        Raises:
            ConfigError: one line, `experiment:LINE: KEY: what is wrong`.
        """
        return cls.from_config(config_of(from_text(text), user_text=user_text))

    @classmethod
    def from_content(cls, content: Mapping[str, Any], user_file: UserFile | None) -> Experiment:
        """The experiment of a dict, of a user's file that has been tried out."""
        names, text = (user_file.names, user_file.text) if user_file else (None, None)
        return cls.from_config(config_of(from_dict(content), user_text=text, names=names), user_file)

    def variant(
        self, analyses: Mapping[str, Options | Mapping[str, Any] | None], axes: Mapping[str, ArrayLike]
    ) -> Experiment:
        """The same experiment with other analyses, on other lanes and without levels.

        Args:
            analyses: name to options; None for those that it has here, or else all defaults.
            axes: values of parameters or of coordinates of the start by name, in place of what the experiment says of
                them; its other axes stay.

        Raises:
            ConfigError: one line, `experiment: KEY: what is wrong`.
        """
        content = {"initial": {}, **without_values(self._data("compare", "explore", "levels"), axes)}
        grids = {name: grid_of(values) for name, values in axes.items()}
        filler = self._filler if not grids else ""
        own = {name: grid for name, grid in content["sweep"].items() if filler or name != self._filler}
        if self._filler and not filler and self._filler not in grids:  # no axis any more, and still what it was
            (value,), file = self._source.data["sweep"][self._filler]["values"], self.user_file
            if file is None or value != file.parameters.get(self._filler, 0.0):
                content["initial" if file and self._filler in file.states else "system"][self._filler] = value
        content["sweep"] = {**own, **grids}
        asked = content["analyses"]
        content["analyses"] = {
            name: asked.get(name) or {} if options is None else _plain_options(options)
            for name, options in analyses.items()
        }
        made = self.from_content(content, self.user_file)
        made._filler = filler
        return made

    def on(self, section: Mapping[str, Any]) -> Experiment:
        """The same experiment on a section, given by keys and values of that block of a config.

        Raises:
            ConfigError: one line, `experiment: section.KEY: what is wrong`.
        """
        content = {**self._data(), "section": {key: value for key, value in section.items() if value is not None}}
        made = self.from_content(content, self.user_file)
        made._filler = self._filler
        return made

    @property
    def filler(self) -> str:
        """The placeholder axis of one value, while no axis is named; "" where there is none."""
        return self._filler

    def _data(self, *without: str) -> dict[str, Any]:
        """The content as it was given, without some blocks."""
        return {key: value for key, value in self._source.data.items() if key not in without}

    # ---- what is run

    def _default_section(self) -> PoincareSection | UserSection:
        """The default section of a flow without a clock."""
        return PoincareSection()

    def _flow(self, parameters: Mapping[str, float]) -> Flow:
        """The system in continuous time, with these parameters in place of its own."""
        return particle_flow(self.system, parameters)

    def flow(self, shared: Mapping[str, float] | None = None) -> Flow:
        """The system in continuous time.

        Args:
            shared: values of shared axes; the first value of each where it is not named.
        """
        swept = {name: grid.first for name, grid in self.sweep.grids.items() if name not in self._of_starts}
        return self._flow({**swept, **(shared or {})})

    def dynamics(self, shared: Mapping[str, float] | None = None) -> System:
        """The system of return maps: the flow, or its section where it has no clock and that is asked for.

        Args:
            shared: as of `flow`.
        """
        flow = self.flow(shared)
        if not self.sectioned:
            return flow
        return section_of(self.section or self._default_section(), self._positions, flow)

    @property
    def _positions(self) -> tuple[str, ...]:
        """Coordinates that a section may be of, in the order of the flow's positions."""
        return "x1", "y1"

    def start(
        self,
        coordinates: Mapping[str, Float[np.ndarray, " count"]],
        count: int,
        shared: Mapping[str, float] | None = None,
        own: Mapping[str, Float[np.ndarray, " count"]] | None = None,
    ) -> State:
        """Start states of lanes, components (count,); of a flow on a section, on their way there.

        Args:
            coordinates: coordinates of the start by name, in place of those that `initial` says.
            count: number of lanes.
            shared: values of shared axes, as of `flow`.
            own: parameters that lanes have of their own.
        """
        flow = self.flow(shared)
        given = {**self.system.start(self.initial), **coordinates}
        state = flow.start({name: np.full(count, value, dtype=np.float64) for name, value in given.items()})
        return begin(self.dynamics(shared), self._admit_starts(flow, state, own or {}, given))

    def _admit_starts(
        self, flow: Flow, start: State, own: Mapping[str, Float[np.ndarray, " count"]], given: Mapping[str, Any]
    ) -> State:
        """Start states, those off the constraints failed or moved; here coordinates satisfy them by construction."""
        return start

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Coordinates of the start state that lanes may have of their own."""
        return tuple(self.system.start(self.initial))

    @property
    def _of_starts(self) -> tuple[str, ...]:
        """Names of all that start states have, and no parameters."""
        return tuple(self.initial.coordinates())

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The axes of the sweep, in the order of the config; their product, in C order, is what is run."""
        return self._axes

    @functools.cached_property
    def _axes(self) -> tuple[Axis, ...]:  # a public one would be among the keys of the model
        flow, of_starts, axes = self.flow(), self._of_starts, []
        for name, grid in self.sweep.grids.items():
            values = grid.grid()
            kind = "lane"
            if name in of_starts:
                kind = "start"
            elif self._is_shared(name, values, flow):
                kind = "shared"
            axes.append(Axis(name, values, flow.readout.labels.long_names[name], kind, flow.readout.labels.units[name]))
        return tuple(axes)

    def _is_shared(self, name: str, values: Float[np.ndarray, " n"], flow: Flow) -> bool:
        """Return whether all lanes of a program must have the same of these values of a parameter."""
        return flow.roles.is_shared(name)

    @property
    def autonomous(self) -> bool:
        """Return whether the scene has no clock: neither forcing nor disturbance."""
        return self.flow().autonomous

    @property
    def sectioned(self) -> bool:
        """Return whether the scene has no clock, and a section is given or an analysis needs one."""
        needed = self.section is not None or not all(options.in_time for options in self.analyses.options().values())
        return needed and self.autonomous

    def requested(self) -> list[tuple[Analysis, Options]]:
        """The analyses asked for, each with its options, in the order of the config; before each those it needs."""
        return [(ANALYSES[name], options) for name, options in self.analyses.options().items()]

    @property
    def user_file(self) -> UserFile | None:
        """The user's file that the system is from, if it is."""
        return None

    @property
    def sha256(self) -> str:
        """Hash, in hex, of what decides the numbers.

        It is taken of the validated content in canonical JSON, so that formatting, comments, the order of keys and
        defaults written out do not change it; the order of the axes, where there are some, does. Nor do `title`,
        `compare` and `explore`, which change no number.
        """
        content = self._content()
        if len(names := tuple(self.sweep.grids)) > 1:
            content["sweep"] = [[name, content["sweep"][name]] for name in names]
        if self.sectioned:
            content["section"] = (self.section or self._default_section()).model_dump(mode="json", exclude_none=True)
        canonical = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(canonical.encode()).hexdigest()

    def _content(self) -> dict[str, Any]:
        """Everything that decides the numbers, defaults written out."""
        return self.model_dump(mode="json", exclude={"title", "compare", "explore"}, exclude_none=True)


class UserExperiment(UserConfig, Experiment):  # pyright: ignore[reportIncompatibleVariableOverride]
    """An experiment of a user's system."""

    _file: UserFile = PrivateAttr()

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

    @property
    def _positions(self) -> tuple[str, ...]:
        return self._file.coordinates

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

    def _default_section(self) -> UserSection:
        return UserSection.model_validate({"coordinate": self._file.coordinates[0]}, context=self._file.names)

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


def _plain_options(options: Options | Mapping[str, Any]) -> dict[str, Any]:
    return options.model_dump(exclude_unset=True) if isinstance(options, Options) else dict(options)


def load(path: str | Path, overrides: Sequence[str] = (), user_text: str | None = None) -> Experiment:
    """Read, override and validate a config.

    Args:
        path: the YAML file.
        overrides: KEY=VALUE, KEY a dotted path into the YAML (a number for an item of a list), VALUE as in YAML;
            analyses.NAME=null drops an analysis, analyses.NAME={} asks for one; null removes a parameter, a start or an
            axis of the file.
        user_text: what the user's file says that the config names, in place of reading it.

    Raises:
        ConfigError: one line, `FILE:LINE: KEY: what is wrong`, or `command line: KEY: ...` for an override; of a
            user's system, also `ITS FILE:LINE: what is wrong`.
    """
    return Experiment.from_config(load_config(path, overrides, user_text))
