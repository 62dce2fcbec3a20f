"""The experiment: what a config says, as frozen records that are valid once they exist. Nothing below sees a raw dict.

The whole lives here; the blocks of all systems in blocks.py, of the particle in particle.py and of users' systems in
user_system.py, what goes with what in fitting.py, YAML and its lines in yaml_source.py, the words for a fault in
messages.py, and which block stands where in layout.py.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from pydantic import Field, PrivateAttr, ValidationError, field_validator, model_validator

from jaxnh.analyses import ANALYSES
from jaxnh.analyses.base import Analysis, Options, Setting, rule
from jaxnh.analyses.scene import Axis
from jaxnh.config.blocks import Accuracy, Analyses, Block, Levels, PublishedValues, SectionBlock, SystemBlock
from jaxnh.config.fitting import check_accuracy, check_analysis, check_levels
from jaxnh.config.layout import layout, user_layout
from jaxnh.config.messages import close_match, first_fault
from jaxnh.config.particle import ConstantSpeed, DisturbedSpeed, Free, Initial, PoincareSection, PrescribedSpeed, Sweep
from jaxnh.config.user_system import UserInitial, UserSection, UserSweep, UserSystem, admitted
from jaxnh.config.yaml_source import ConfigSource, from_dict, from_text, read
from jaxnh.exceptions import ConfigError, InputError
from jaxnh.maps.section import System, begin
from jaxnh.systems.flow import Flow
from jaxnh.systems.state import State
from jaxnh.systems.user_file import UserFile

__all__ = ["Experiment", "load"]

# ---- the whole


class Experiment(Block):
    """A validated config; made by `load`, `Experiment.from_dict` or `Experiment.from_text`."""

    title: str = Field(default="", description="What this run is, in words")
    system: ConstantSpeed | DisturbedSpeed | Free = Field(
        discriminator="constraint", description="The constraint on the speed, the parameters, and what is left out"
    )
    initial: Initial = Field(default=Initial(), description="Start state at t = 0, where it is not swept")
    sweep: Sweep = Field(description="The parameters and start coordinates that differ from lane to lane: their values")
    levels: Levels | None = Field(
        default=None, description="From coarse to fine: levels of the sweep, each a result that can be read"
    )
    section: PoincareSection | None = Field(
        default=None, description="Without forcing and disturbance, the section whose crossings take the strobe's place"
    )
    accuracy: Accuracy = Field(default=Accuracy(), description="Error allowed, or solver and steps")
    analyses: Analyses = Field(description="What to compute: name of the analysis to its options")
    compare: dict[str, PublishedValues] | None = Field(
        default=None, description="Published values to show beside ours: name of the analysis to source and numbers"
    )

    _origin: ConfigSource | None = PrivateAttr(default=None)
    _filler: str = PrivateAttr(default="")

    # ---- how it is made

    @classmethod
    def from_dict(cls, content: Mapping[str, Any], overrides: Sequence[str] = ()) -> Experiment:
        """The experiment of a dict that says what a YAML file would say; a user's file is named from where one is.

        Args:
            content: mappings, lists, text, numbers and booleans; NumPy's arrays and numbers as well.
            overrides: KEY=VALUE, as of `load`.

        Raises:
            ConfigError: one line, `experiment: KEY: what is wrong`.
        """
        return validated(from_dict(content, overrides), Path())

    @classmethod
    def from_text(cls, text: str, user_text: str | None = None) -> Experiment:
        """The experiment of the text of a YAML file.

        Args:
            text: such as `Experiment.text` of another one.
            user_text: what the user's file says that the config names, in place of reading it.

        Raises:
            ConfigError: one line, `experiment:LINE: KEY: what is wrong`.
        """
        return validated(from_text(text), Path(), user_text)

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
        content = self._data("compare", "levels")
        for block in ("system", "initial"):
            given = content.get(block) or {}
            content[block] = {key: value for key, value in given.items() if key not in axes}
        grids = {name: _grid(values) for name, values in axes.items()}
        filler = self._filler if not grids else ""
        own = {name: grid for name, grid in content["sweep"].items() if filler or name != self._filler}
        content["sweep"] = {**own, **grids}
        asked = content["analyses"]
        content["analyses"] = {
            name: asked.get(name) or {} if options is None else _plain_options(options)
            for name, options in analyses.items()
        }
        made = validated(from_dict(content), Path(), user_file=self.user_file)
        made._filler = filler
        return made

    def on(self, section: Mapping[str, Any]) -> Experiment:
        """The same experiment, seen on a section: keys and values of that block of a config.

        Raises:
            ConfigError: one line, `experiment: section.KEY: what is wrong`.
        """
        content = {**self._data(), "section": {key: value for key, value in section.items() if value is not None}}
        made = validated(from_dict(content), Path(), user_file=self.user_file)
        made._filler = self._filler
        return made

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the config, and beside it the user's file that it names: a job for `jaxnh sweep`.

        Args:
            path: of the config.
            overwrite: whether files that are there and say something else are replaced.

        Raises:
            InputError: such a file is there, or it cannot be written.
        """
        path = Path(path)
        texts = {path: self.text}
        if self.user_file is not None:
            texts[path.parent / self._data()["system"]["file"]] = self.user_file.text
        for target, text in texts.items():
            if not overwrite and target.exists() and target.read_text(encoding="utf-8") != text:
                raise InputError(f"{target} is there and says something else; overwrite=True replaces it")
        for target, text in texts.items():
            try:
                target.write_text(text, encoding="utf-8")
            except OSError as error:
                raise InputError(f"{target}: cannot be written: {error.strerror}") from None

    @property
    def filler(self) -> str:
        """The axis of one value that stands in while none is named; "" where there is none."""
        return self._filler

    def _data(self, *without: str) -> dict[str, Any]:
        """The content as it was given, without some blocks."""
        data = self._origin.data if self._origin else {}
        return {key: value for key, value in data.items() if key not in without}

    # ---- rules

    @field_validator("compare")
    @classmethod
    def _known(cls, compare: dict[str, PublishedValues] | None) -> dict[str, PublishedValues] | None:
        for name in compare or {}:
            if name not in ANALYSES:
                raise rule(f"unknown analysis{close_match(name, ANALYSES)}; known are {', '.join(ANALYSES)}", name)
        return compare

    @model_validator(mode="after")
    def _check(self) -> Experiment:
        self.sweep.check()
        self._block.check(self.initial, self.sweep)
        requested = self.requested()
        check_accuracy(
            self.accuracy, requested, prescribed=isinstance(self.system, PrescribedSpeed), clock=not self.autonomous
        )
        if self.section and not self.autonomous:
            raise rule("this scene has a clock, and is seen at its strobes; leave section out", "section")
        axes = self.axes
        setting = Setting(
            self.flow(), self.autonomous, axes, self.precision, lambda value: self.flow({axes[0].name: value})
        )
        for analysis, options in requested:
            check_analysis(analysis, options, setting)
        if self.levels:
            check_levels(self.levels, {name: grid.size for name, grid in self.sweep.grids.items()}, requested)
        return self

    # ---- what is run

    def _default_section(self) -> SectionBlock:
        """Where a scene without a clock is looked at if the config does not say."""
        return PoincareSection()

    @property
    def _block(self) -> SystemBlock:
        return self.system

    def flow(self, shared: Mapping[str, float] | None = None) -> Flow:
        """What moves, in continuous time.

        Args:
            shared: values of shared axes; the first value of each where it is not named.
        """
        coordinates = self.initial.coordinates()
        swept = {name: grid.first for name, grid in self.sweep.grids.items() if name not in coordinates}
        return self._block.flow({**swept, **(shared or {})})

    def dynamics(self, shared: Mapping[str, float] | None = None) -> System:
        """What return maps are of: the flow, or its section where it has no clock and that is asked for.

        Args:
            shared: as of `flow`.
        """
        flow = self.flow(shared)
        return (self.section or self._default_section()).of(flow) if self.sectioned else flow

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
        given = {**self._block.start(self.initial), **coordinates}
        state = flow.start({name: np.full(count, value, dtype=np.float64) for name, value in given.items()})
        return begin(self.dynamics(shared), self._admitted(flow, state, own or {}))

    def _admitted(self, flow: Flow, start: State, own: Mapping[str, Float[np.ndarray, " count"]]) -> State:
        """Start states, those that the constraints do not admit failed or moved: here their coordinates see to it."""
        return start

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Coordinates of the start state that lanes may have of their own."""
        return tuple(self._block.start(self.initial))

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The axes of the sweep, in the order of the config; their product, in C order, is what is run.

        Made anew at every call.
        """
        flow, coordinates, found = self.flow(), self.initial.coordinates(), []
        for name, grid in self.sweep.grids.items():
            values = grid.grid()
            kind = "lane"
            if name in coordinates:
                kind = "start"
            elif self._block.is_shared(name, values, flow):
                kind = "shared"
            found.append(Axis(name, values, flow.labels.long_names[name], kind, flow.labels.units[name]))
        return tuple(found)

    @property
    def autonomous(self) -> bool:
        """Whether the scene has no clock: neither forcing nor disturbance."""
        return self.flow().autonomous

    @property
    def sectioned(self) -> bool:
        """Whether the scene is looked at on a section: it has no clock, and one is given or an analysis needs one."""
        needed = self.section is not None or not all(analysis.in_time for analysis, _ in self.requested())
        return needed and self.autonomous

    @property
    def precision(self) -> str:
        """Arithmetic within a period: "float64", or "float32" or "extended" where it is asked for."""
        return self.accuracy.precision or "float64"

    def too_large(self, would: str) -> ConfigError:
        """What to say of a sweep that has too many lanes, at the axis that is most likely meant to be shorter.

        Args:
            would: what it would take, and what to do.
        """
        grids = self.sweep.grids
        keys = [("sweep",), *(("sweep", name, key) for key in ("count", "values") for name in grids)]
        keys += [("sweep", name) for name in grids]
        counts = " x ".join(f"{grid.size:,}" for grid in grids.values())
        message = f"{counts} are {self.sweep.lanes:,} lanes{would}"
        return self._origin.error(self._origin.blame(keys), message) if self._origin else ConfigError(message)

    def unlike(self, published: PublishedValues) -> list[str]:
        """In words, in what system and start differ from those that published values are of; the first axis may."""
        theirs = {**published.system, **published.initial}
        ours = self._parameters()
        first, *others = self.sweep.grids
        found = [f"{name} is swept" for name in others]
        for name in dict.fromkeys([*ours, *theirs]):
            here, there = ours.get(name), theirs.get(name)
            if name != first and name not in others and here != there:
                found.append(f"{name} is {_said(here)} here, {_said(there)} there")
        return found

    def requested(self) -> list[tuple[Analysis, Options]]:
        """The analyses asked for, each with its options, in the order of the config; before each those it needs."""
        return self.analyses.requested()

    # ---- where it is from

    @property
    def source(self) -> Path | None:
        """The file this was read from, as the user named it; None where there is none."""
        return self._origin.path if self._origin else None

    @property
    def label(self) -> str:
        """What messages call it: the name of the file, or "experiment"."""
        return str(self.source or "experiment")

    @property
    def text(self) -> str:
        """The YAML as run: a file's text, with the overrides applied and the comments kept."""
        return self._origin.text if self._origin else ""

    def _repr_html_(self) -> str:
        """What a notebook shows of it: its title and the YAML."""
        return f"<b>{escape(self.title or self.label)}</b><pre>{escape(self.text)}</pre>"

    @property
    def user_file(self) -> UserFile | None:
        """The user's file that the system is from, if it is."""
        return None

    @property
    def sha256(self) -> str:
        """Hash, in hex, of what decides the numbers.

        It is taken of the validated content in canonical JSON, so that formatting, comments, the order of keys and
        defaults written out do not change it; the order of the axes, where there are some, does. Nor do `title` and
        `compare`, which change no number.
        """
        content = self._content()
        if len(names := tuple(self.sweep.grids)) > 1:
            content["sweep"] = [[name, content["sweep"][name]] for name in names]
        if self.sectioned:
            content["section"] = (self.section or self._default_section()).model_dump(mode="json", exclude_none=True)
        canonical = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(canonical.encode()).hexdigest()

    def _content(self) -> dict[str, Any]:
        """What decides the numbers, defaults written out."""
        return self.model_dump(mode="json", exclude={"title", "compare"}, exclude_none=True)

    def _parameters(self) -> dict[str, Any]:
        """Parameters of the system and coordinates of its start, defaults included, those without a value left out."""
        content = {**self.system.model_dump(mode="json"), **self.initial.coordinates()}
        return {name: value for name, value in content.items() if value is not None}


class UserExperiment(Experiment):
    """A validated config of a user's system."""

    system: UserSystem = Field(description="The user's file, and the parameters")  # pyright: ignore[reportIncompatibleVariableOverride, reportGeneralTypeIssues]
    initial: UserInitial = Field(  # pyright: ignore[reportIncompatibleVariableOverride]
        default_factory=dict, validate_default=True, description="Start state at t = 0, where it is not swept"
    )
    sweep: UserSweep = Field(  # pyright: ignore[reportIncompatibleVariableOverride]
        description="The parameters and start coordinates that differ from lane to lane: their values"
    )
    section: UserSection | None = Field(  # pyright: ignore[reportIncompatibleVariableOverride]
        default=None, description="Of a system without a clock, the section whose crossings take the strobe's place"
    )

    @model_validator(mode="after")
    def _check_section(self) -> UserExperiment:
        """What is found at crossings needs a section."""
        seen = [analysis.name for analysis, _ in self.requested() if not analysis.in_time]
        if self.autonomous and self.section is None and seen:
            first = self.user_file.coordinates[0]
            message = (
                f"the system has no period, and {seen[0]} looks at it on a section: give one, "
                f"as section: {{coordinate: {first}, value: 0.0, direction: up}}"
            )
            raise rule(message, "section", f"analyses.{seen[0]}", "analyses")
        return self

    def _admitted(self, flow: Flow, start: State, own: Mapping[str, Float[np.ndarray, " count"]]) -> State:
        return admitted(flow, start, own, project=self.initial.project)

    def _default_section(self) -> SectionBlock:
        return UserSection.model_validate({"coordinate": self.user_file.coordinates[0]}, context=self.user_file)

    @property
    def user_file(self) -> UserFile:
        """The user's file that the system is from."""
        return self.system.user_file

    def _content(self) -> dict[str, Any]:
        system = {**self.system.parameters, "file": self.user_file.sha256}
        initial = {**self.initial.coordinates(), **({"project": True} if self.initial.project else {})}
        return {**super()._content(), "system": system, "initial": initial}

    def _parameters(self) -> dict[str, Any]:
        return {"file": self.system.file, **self.system.parameters, **self.initial.coordinates()}


# ---- from a source to an experiment


def _said(value: Any) -> str:
    return "not given" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _grid(values: ArrayLike) -> dict[str, Any]:
    """Values of an axis as a config has them; what is no such thing is left as it is, for the config to refuse."""
    try:
        given = np.atleast_1d(np.asarray(values, float))
    except (TypeError, ValueError):
        return {"values": values}
    if given.ndim == 1 and len(given) > 2 and np.isfinite(given).all() and given[0] != given[-1]:
        grid = {"start": float(given[0]), "stop": float(given[-1]), "count": len(given)}
        if np.array_equal(given, np.linspace(*grid.values())):
            return grid
    return {"values": given.tolist()}


def _plain_options(options: Options | Mapping[str, Any]) -> dict[str, Any]:
    return options.model_dump(exclude_unset=True) if isinstance(options, Options) else dict(options)


def validated(
    source: ConfigSource, folder: Path, user_text: str | None = None, user_file: UserFile | None = None
) -> Experiment:
    """The experiment that a source says.

    Args:
        folder: where a user's file is named from.
        user_text: what that file says, in place of reading it.
        user_file: the file, where it has been read and tried out before.
    """
    _drop_analyses(source)
    system, sweep = source.data.get("system"), source.data.get("sweep")
    file = system.get("file") if isinstance(system, dict) else None
    axes = sweep if isinstance(sweep, dict) else ()
    if not isinstance(file, str):
        model, where, context = Experiment, layout(Experiment, Sweep.model_fields), None
    else:
        if user_file is None and user_text is None and not (folder / file).is_file():
            raise source.error(("system", "file"), f"there is no file {folder / file}")
        context = user_file or UserFile(folder / file, user_text)
        model, where = UserExperiment, user_layout(UserExperiment, axes)
    try:
        experiment = model.model_validate(source.data, context=context)
    except ValidationError as error:
        raise first_fault(error, source, where) from None
    experiment._origin = source
    return experiment


def _drop_analyses(source: ConfigSource) -> None:
    """Leave out the analyses that overrides say are null; in a file null stands for all defaults."""
    asked = source.data.get("analyses")
    for *block, name in source.overridden:
        if block == ["analyses"] and name in ANALYSES and isinstance(asked, dict) and asked.get(name, ...) is None:
            del asked[name], source.tree["analyses"][name]


def load(path: str | Path, overrides: Sequence[str] = (), user_text: str | None = None) -> Experiment:
    """Read, override and validate a config.

    Args:
        path: the YAML file.
        overrides: KEY=VALUE, KEY a dotted path into the YAML (a number for an item of a list), VALUE as in YAML;
            analyses.NAME=null drops an analysis, analyses.NAME={} asks for one; null leaves out what the file says of
            a parameter, a start or an axis.
        user_text: what the user's file says that the config names, in place of reading it.

    Raises:
        ConfigError: one line, `FILE:LINE: KEY: what is wrong`, or `command line: KEY: ...` for an override; of a
            user's system, also `ITS FILE:LINE: what is wrong`.
    """
    if not isinstance(path, str | Path):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise InputError(f"load takes the path of a YAML file, not {type(path).__name__}")
    path = Path(path)
    return validated(read(path, overrides), path.parent, user_text)
