"""Base of the experiments of all systems: making, flow, start states and axes, and their hash.

Keys of a config, and all checks that need no JAX, are in `config`.
"""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

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
from jaxnh.config.blocks import SectionBlock
from jaxnh.config.config import Config, config_of, load_config
from jaxnh.config.messages import fault_of_rule
from jaxnh.config.values import grid_of, without_values
from jaxnh.config.yaml_source import from_dict, from_text
from jaxnh.engine.fitting import check_analyses, check_levels
from jaxnh.exceptions import InputError
from jaxnh.maps.section import Section, System, begin
from jaxnh.systems.flow import Flow
from jaxnh.systems.state import State
from jaxnh.systems.user_file import UserFile


class Experiment(Config, frozen=True):
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
        kind = next(kind for kind in Experiment.__subclasses__() if issubclass(kind, type(config)))
        made = kind._copied(config, user_file)
        try:
            with jax.enable_x64(True):  # a script may load a config before it has started a session
                made._try_out()
        except PydanticCustomError as broken:
            raise fault_of_rule(broken, config._source) from None
        return made

    @classmethod
    def _copied(cls, config: Config, user_file: UserFile | None) -> Self:
        """A config as an experiment of this kind, whose flow has not been tried out."""
        made = cls.model_construct(config.model_fields_set, **dict(config))
        made._set_private(**{name: getattr(config, name) for name in config.__private_attributes__})
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
        made._set_private(_filler=filler)
        return made

    def on(self, section: Mapping[str, Any]) -> Experiment:
        """The same experiment on a section, given by keys and values of that block of a config.

        Raises:
            ConfigError: one line, `experiment: section.KEY: what is wrong`.
        """
        content = {**self._data(), "section": {key: value for key, value in section.items() if value is not None}}
        made = self.from_content(content, self.user_file)
        made._set_private(_filler=self._filler)
        return made

    @property
    def filler(self) -> str:
        """The placeholder axis of one value, while no axis is named; "" where there is none."""
        return self._filler

    def _data(self, *without: str) -> dict[str, Any]:
        """The content as it was given, without some blocks."""
        return {key: value for key, value in self._source.data.items() if key not in without}

    # ---- what is run

    # Each kind of experiment has these.

    def _flow(self, parameters: Mapping[str, float]) -> Flow:
        """The system in continuous time, with these parameters in place of its own."""
        raise NotImplementedError

    @property
    def _section(self) -> SectionBlock:
        """The section that is given, or the default one of a flow without a clock."""
        raise NotImplementedError

    def _on_section(self, flow: Flow) -> Section:
        """The section of a flow that is asked for."""
        raise NotImplementedError

    @property
    def _of_starts(self) -> tuple[str, ...]:
        """Names of all that start states have, and no parameters."""
        raise NotImplementedError

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
        return self._on_section(flow) if self.sectioned else flow

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
        """Start states, those off the constraints failed or moved; a particle's are on them by construction."""
        return start

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Coordinates of the start state that lanes may have of their own."""
        return tuple(self.system.start(self.initial))

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
            content["section"] = self._section.model_dump(mode="json", exclude_none=True)
        canonical = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(canonical.encode()).hexdigest()

    def _content(self) -> dict[str, Any]:
        """Everything that decides the numbers, defaults written out."""
        return self.model_dump(mode="json", exclude={"title", "compare", "explore"}, exclude_none=True)


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
