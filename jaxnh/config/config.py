"""The content of a config, as frozen records that are valid once they exist. Nothing here imports JAX.

The blocks of all systems are in blocks.py, of the particle in particle.py and of users' systems in user_system.py, the
options of analyses in options/, what goes with what in fitting.py, YAML and its lines in yaml_source.py, words for a
fault in messages.py, and which block stands where in layout.py. `engine.experiment` makes of a config what is run.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import ConfigDict, Field, PrivateAttr, ValidationError, field_validator, model_validator

from jaxnh.analyses.options import OPTIONS
from jaxnh.analyses.options.base import Block, rule
from jaxnh.config.blocks import (
    Accuracy,
    Analyses,
    ExploreBlock,
    InitialBlock,
    Levels,
    PublishedValues,
    SectionBlock,
    SweepBlock,
    SystemBlock,
)
from jaxnh.config.fitting import check_accuracy, check_map_accuracy
from jaxnh.config.layout import layout
from jaxnh.config.messages import Layout, close_match, first_fault, show_value
from jaxnh.config.particle import ConstantSpeed, DisturbedSpeed, Free, Initial, PoincareSection, Sweep
from jaxnh.config.user_system import UserAccuracy, UserInitial, UserSection, UserSweep, UserSystem
from jaxnh.config.yaml_source import ConfigSource, read
from jaxnh.exceptions import ConfigError, InputError, take_path
from jaxnh.systems.user_text import Names, names_in, read_text


class Config(Block, frozen=True):
    """A validated config."""

    model_config = ConfigDict(title="Experiment")

    # Each kind of config has its own type for the fields without a description here.
    title: str = Field(default="", description="Title of the run")
    system: SystemBlock
    initial: InitialBlock
    sweep: SweepBlock
    levels: Levels | None = Field(
        default=None, description="From coarse to fine: levels of the sweep, each a result that can be read"
    )
    section: SectionBlock | None
    accuracy: Accuracy
    analyses: Analyses = Field(description="Analyses to run: name of each to its options")
    device: Literal["cpu", "gpu"] | None = Field(
        default=None, description="Kind of device that computes; by default the one that JAX prefers here"
    )
    compare: dict[str, PublishedValues] | None = Field(
        default=None, description="Published values to show beside ours: name of the analysis to source and numbers"
    )
    explore: ExploreBlock | None = Field(default=None, description="The view that jaxnh explore opens with")

    _source: ConfigSource = PrivateAttr()

    # ---- rules

    @field_validator("compare")
    @classmethod
    def _known(cls, compare: dict[str, PublishedValues] | None) -> dict[str, PublishedValues] | None:
        for name in compare or {}:
            if name not in OPTIONS:
                raise rule(f"unknown analysis{close_match(name, OPTIONS)}; known are {', '.join(OPTIONS)}", name)
        return compare

    @model_validator(mode="after")
    def _check(self) -> Config:
        self.sweep.check()
        self.system.check(self.initial, self.sweep)
        clock = self.system.has_clock(self.sweep)
        if clock is not None:
            self.check_clock(clock)
        return self

    def check_clock(self, clock: bool) -> None:
        """Check accuracy and section, which depend on whether the system has a clock.

        Raises:
            ValueError: they do not go with it; the rule names the key.
        """
        check_accuracy(self.accuracy, self.analyses.options(), prescribed=self.system.prescribed, clock=clock)
        if self.section and clock:
            raise rule("this scene has a clock, and is seen at its strobes; leave section out", "section")

    @property
    def precision(self) -> str:
        """Arithmetic within a period: "float64", or "float32" or "extended" where it is asked for."""
        return self.accuracy.precision or "float64"

    def too_large(self, would: str) -> ConfigError:
        """Return the error of a sweep that has too many lanes, at the axis that is most likely meant to be shorter.

        Args:
            would: what it would take, and what to do.
        """
        grids = self.sweep.grids
        keys = [("sweep",), *(("sweep", name, key) for key in ("count", "values") for name in grids)]
        keys += [("sweep", name) for name in grids]
        counts = " x ".join(f"{grid.size:,}" for grid in grids.values()) + " are " if len(grids) > 1 else ""
        return self._source.error(self._source.blame(keys), f"{counts}{self.sweep.lanes:,} lanes{would}")

    def missing_device(self, there: str) -> ConfigError:
        """Return the error of a kind of device that JAX does not find, which finds others."""
        return self._source.error(
            ("device",), f"JAX finds no {self.device} here, but {there}; leave it out, or install JAX for it"
        )

    # ---- published values

    def differences_from(self, published: PublishedValues) -> list[str]:
        """Describe how system and start differ from those that published values are of; the first axis may."""
        theirs = {**published.system, **published.initial}
        ours = self._parameters()
        first, *others = self.sweep.grids
        differences = [f"{name} is swept" for name in others]
        for name in dict.fromkeys([*ours, *theirs]):
            own, other = ours.get(name), theirs.get(name)
            if name != first and name not in others and own != other:
                differences.append(f"{name} is {_value_in_words(own)} here, {_value_in_words(other)} there")
        return differences

    def _parameters(self) -> dict[str, Any]:
        """Parameters of the system and coordinates of its start, defaults included, those without a value left out."""
        content = {**self.system.model_dump(mode="json"), **self.initial.coordinates()}
        return {name: value for name, value in content.items() if value is not None}

    # ---- where it is from

    @property
    def source(self) -> Path | None:
        """The file this was read from, as the user named it; None where there is none."""
        return self._source.path

    @property
    def label(self) -> str:
        """Describe what messages call it: the name of the file, or "experiment"."""
        return str(self.source or "experiment")

    @property
    def text(self) -> str:
        """The YAML as run: a file's text, with the overrides applied and the comments kept."""
        return self._source.text

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the config, and beside it the user's file that it names: a job for `jaxnh sweep`.

        Args:
            path: of the config.
            overwrite: whether files that are there and say something else are replaced.

        Raises:
            InputError: such a file is there, or it cannot be written.
        """
        file = take_path(path, "save", "YAML file")
        texts = {file: self.text, **self._texts_beside(file.parent)}
        for target, text in texts.items():
            if not overwrite and target.exists() and target.read_text(encoding="utf-8") != text:
                raise InputError(f"{target} is there and says something else; overwrite=True replaces it")
        for target, text in texts.items():
            try:
                target.write_text(text, encoding="utf-8")
            except OSError as error:
                raise InputError(f"{target}: cannot be written: {error.strerror}") from None

    def _texts_beside(self, folder: Path) -> dict[Path, str]:
        """Files that the config names, by where they belong if the config is in a folder."""
        return {}

    def _repr_html_(self) -> str:
        """Return the title and the YAML, for a notebook."""
        return f"<b>{escape(self.title or self.label)}</b><pre>{escape(self.text)}</pre>"


class ParticleConfig(Config, frozen=True):
    """A validated config of the paper's particle."""

    system: ConstantSpeed | DisturbedSpeed | Free = Field(
        discriminator="constraint", description="The constraint on the speed, the parameters, and what is left out"
    )
    initial: Initial = Field(default=Initial(), description="Start state at t = 0, where it is not swept")
    sweep: Sweep = Field(description="The parameters and start coordinates that differ from lane to lane: their values")
    section: PoincareSection | None = Field(
        default=None, description="Without forcing and disturbance, the section whose crossings take the strobe's place"
    )
    accuracy: Accuracy = Field(default=Accuracy(), description="Error allowed, or solver and steps")


class UserConfig(Config, frozen=True):
    """A validated config of a user's system."""

    system: UserSystem = Field(description="The user's file, and the parameters")
    initial: UserInitial = Field(
        default_factory=dict, validate_default=True, description="Start state at t = 0, where it is not swept"
    )
    sweep: UserSweep = Field(
        description="The parameters and start coordinates that differ from lane to lane: their values"
    )
    section: UserSection | None = Field(
        default=None, description="Of a system without a clock, the section whose crossings take the strobe's place"
    )
    accuracy: UserAccuracy = Field(
        default_factory=dict, validate_default=True, description="Error allowed, or solver and steps"
    )

    _names: Names = PrivateAttr()
    _path: Path = PrivateAttr()
    _user_text: str = PrivateAttr()

    @property
    def user_text(self) -> str:
        """Text of the user's file."""
        return self._user_text

    def check_clock(self, clock: bool) -> None:
        """Check accuracy and section; crossings need a section that the config gives."""
        super().check_clock(clock)
        asked_for = self.analyses.asked_for()
        needed = {word for name, _ in asked_for for word in OPTIONS[name].needs}
        at_crossings = [name for name, options in asked_for if not all(each.in_time for each in options)]
        at_crossings.sort(key=lambda name: name in needed)
        if not clock and self.section is None and at_crossings:
            first = (self._names.coordinates or ("x",))[0]
            message = (
                f"the system has no period, and {at_crossings[0]} looks at it on a section: give one, "
                f"as section: {{coordinate: {first}, value: 0.0, direction: up}}, "
                f"or of a session by on(coordinate='{first}')"
            )
            raise rule(message, "section", f"analyses.{at_crossings[0]}", "analyses")

    def check_map(self) -> None:
        """Check that nothing is asked of a map that only flows have.

        Raises:
            ValueError: something is; the rule names the key.
        """
        check_map_accuracy(self.accuracy)
        if self.section:
            raise rule("a map is seen at its iterates; leave section out", "section")

    def _texts_beside(self, folder: Path) -> dict[Path, str]:
        return {folder / self.system.file: self._user_text}


def _value_in_words(value: Any) -> str:
    return "not given" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


# ---- from a source to a config


def config_of(
    source: ConfigSource, folder: Path = Path(), user_text: str | None = None, names: Names | None = None
) -> Config:
    """The config that a source says.

    Args:
        folder: where a user's file is named from.
        user_text: content of that file, in place of reading it.
        names: of its system, in place of those that its text alone gives.

    Raises:
        ConfigError: the source is no config, or names a file that is not there or no Python.
    """
    _drop_analyses(source)
    system, axes = source.data.get("system"), source.data.get("sweep")
    file = system.get("file") if isinstance(system, dict) else None
    if file is not None and not isinstance(file, str):
        raise source.error(("system", "file"), f"must be the name of a Python file, not {show_value(file)}")
    if file is None:
        return _validate(ParticleConfig, source, layout(ParticleConfig, Sweep.model_fields))
    path = folder / file
    user_text = _user_text(source, path) if user_text is None else user_text
    names = names or names_in(user_text, path)
    where = layout(UserConfig, axes if isinstance(axes, dict) else ())
    config = _validate(UserConfig, source, where, names)
    config._set_private(_names=names, _path=path, _user_text=user_text)
    return config


def _user_text(source: ConfigSource, path: Path) -> str:
    """Text of a user's file; where it is not there, the one that a saved view carries.

    Raises:
        ConfigError: there is neither, or they say different things.
    """
    explore = source.data.get("explore")
    carried = explore.get("system_file") if isinstance(explore, dict) else None
    if not path.is_file():
        if isinstance(carried, str):
            return carried
        raise source.error(("system", "file"), f"there is no file {path}")
    text = read_text(path)
    if isinstance(carried, str) and carried != text:
        raise source.error(
            ("explore", "system_file"), f"{path} is there and says something else; leave out one of the two"
        )
    return text


def load_config(path: str | Path, overrides: Sequence[str] = (), user_text: str | None = None) -> Config:
    """Read, override and validate a config, as `engine.experiment.load`, as far as JAX is not needed.

    Raises:
        ConfigError: one line, `FILE:LINE: KEY: what is wrong`.
    """
    file = take_path(path, "load", "YAML file")
    if isinstance(overrides, str):
        raise InputError(f"overrides are a list, as [{overrides!r}], and not one text")
    return config_of(read(file, overrides), file.parent, user_text)


_C = TypeVar("_C", bound=Config)


def _validate(model: type[_C], source: ConfigSource, where: Layout, names: Names | None = None) -> _C:
    try:
        config = model.model_validate(source.data, context=names)
    except ValidationError as error:
        raise first_fault(error, source, where) from None
    config._set_private(_source=source)
    return config


def _drop_analyses(source: ConfigSource) -> None:
    """Leave out the analyses that overrides say are null; in a file null stands for all defaults."""
    asked = source.data.get("analyses")
    for *block, name in source.overridden:
        if block == ["analyses"] and name in OPTIONS and isinstance(asked, dict) and asked.get(name, ...) is None:
            del asked[name], source.tree["analyses"][name]
