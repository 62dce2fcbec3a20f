"""The experiment: what a config says, as frozen records that are valid once they exist. Nothing below sees a raw dict.

The models and their rules live here; YAML and its lines in yaml_source.py, the words for a fault in faults.py.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    PrivateAttr,
    ValidationError,
    create_model,
    field_validator,
    model_validator,
)
from pydantic.json_schema import GenerateJsonSchema

from jaxnh.analyses import ANALYSES
from jaxnh.analyses.base import Analysis, Options
from jaxnh.config.blocks import Evenly, Named, Section
from jaxnh.config.messages import Layout, close_match, first_fault, rule, shown
from jaxnh.config.particle import (
    ConstantSpeed,
    DisturbedSpeed,
    EventSection,
    Free,
    Initial,
    PlanarSystem,
    PrescribedSpeed,
    Sweep,
)
from jaxnh.config.user_system import own_sections, with_own_systems
from jaxnh.config.yaml_source import ConfigError, KeyPath, read
from jaxnh.maps.section import Crossing
from jaxnh.solvers import RUNGE_KUTTA, SOLVERS, SPLITTINGS
from jaxnh.systems.user_file import OwnSystem, OwnSystemError

__all__ = ["ConfigError", "Experiment", "load", "schema"]

_SOLVERS = tuple(SOLVERS)
_BY_NEWTON = ("doubling", "period")
_ON_SECTIONS = ("lyapunov", "period", "portrait", "poincare", "diagram", "chaos01")


# ---- accuracy, analyses, published values


class Accuracy(Section):
    """How accurate the map of one period is to be, or by which method and steps it is computed."""

    target: float = Field(
        default=1e-10, ge=1e-13, le=1e-2, description="Largest error of one period's map that is allowed"
    )
    solver: str | None = Field(
        default=None,
        description="Solver to use instead of the one chosen for the target; needs steps",
        json_schema_extra={"enum": [*_SOLVERS, None]},
    )
    steps: int | None = Field(
        default=None, ge=1, le=1_000_000, description="Steps a period instead of those chosen for the target"
    )

    precision: Literal["float64", "float32"] | None = Field(
        default=None,
        description="Arithmetic within a period: float64, or if asked for float32, with errors of 1e-5 and more",
    )

    @field_validator("solver")
    @classmethod
    def _known(cls, solver: str | None) -> str | None:
        if solver is not None and solver not in _SOLVERS:
            raise rule(f"must be one of {', '.join(_SOLVERS)}, not {shown(solver)}{close_match(solver, _SOLVERS)}")
        return solver

    @model_validator(mode="after")
    def _check(self) -> Accuracy:
        if (self.solver is None) != (self.steps is None):
            given, absent = ("solver", "steps") if self.steps is None else ("steps", "solver")
            raise rule(f"solver and steps go together; give {absent} as well", given)
        if self.precision == "float32" and self.solver in RUNGE_KUTTA:
            raise rule(f"float32 goes with the splittings, and {self.solver} is none", "precision", "solver")
        return self


class AnalysesBase(Section):
    """The analyses asked for, each with its options; None where an analysis is absent."""

    _order: tuple[str, ...] = PrivateAttr(default=())

    @model_validator(mode="wrap")
    @classmethod
    def _defaults(cls, content: Any, handler: ModelWrapValidatorHandler[AnalysesBase]) -> AnalysesBase:
        """A name with nothing behind it means all defaults; the order of the names is kept."""
        if content in (None, {}):
            raise rule(f"at least one analysis is needed; known are {', '.join(ANALYSES)}")
        if not isinstance(content, dict):
            return handler(content)
        analyses = handler({name: {} if options is None else options for name, options in content.items()})
        analyses._order = tuple(content)
        return analyses

    def requested(self) -> list[tuple[Analysis, Options]]:
        """Each analysis with its options, in the order of the config; those that one needs come before it."""
        order: list[str] = []
        for name in self._order:
            order += [need for need in (*ANALYSES[name].needs, name) if need not in order]
        return [(ANALYSES[name], getattr(self, name) or ANALYSES[name].options()) for name in order]


if TYPE_CHECKING:
    Analyses = AnalysesBase
else:
    Analyses = create_model(
        "Analyses",
        __base__=AnalysesBase,
        __doc__=AnalysesBase.__doc__,
        **{
            name: (
                analysis.options | None,
                Field(default=None, description=f"Options of {name}; nothing or {{}} for all defaults"),
            )
            for name, analysis in ANALYSES.items()
        },
    )


def _nan_for_null(column: tuple[float | None, ...]) -> tuple[float, ...]:
    return tuple(math.nan if number is None else number for number in column)


Column = Annotated[tuple[float | None, ...], Field(strict=False), AfterValidator(_nan_for_null)]
"""Published numbers of one variable; NaN where the publication has none (null in YAML)."""


class Published(Section):
    """Published values of an analysis: where they are from, and a list of numbers a variable."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Column] = Field(init=False)  # pyright: ignore[reportIncompatibleVariableOverride]

    source: str = Field(description="Where the values are published")

    def columns(self) -> dict[str, np.ndarray]:
        """Variable name to its published values, each float64 of shape (n,)."""
        return {name: np.array(column, dtype=np.float64) for name, column in self.__pydantic_extra__.items()}


# ---- the whole


class Experiment(Section):
    """A validated config. Made by `load`, which also sets `source` and `text`."""

    title: str = Field(default="", description="What this run is, in words")
    system: ConstantSpeed | DisturbedSpeed | Free = Field(
        discriminator="constraint", description="The constraint on the speed, the parameters, and what is left out"
    )
    initial: Initial = Field(default=Initial(), description="Start state at t = 0, the same for all lanes")
    sweep: Sweep = Field(description="The parameter that differs from lane to lane, and its values")
    section: EventSection | None = Field(
        default=None, description="Without forcing and disturbance, the section whose crossings take the strobe's place"
    )
    accuracy: Accuracy = Field(default=Accuracy(), description="Error allowed, or solver and steps")
    analyses: Analyses = Field(description="What to compute: name of the analysis to its options")
    compare: dict[str, Published] | None = Field(
        default=None, description="Published values to show beside ours: name of the analysis to source and numbers"
    )

    _source: Path = PrivateAttr(default=Path())
    _text: str = PrivateAttr(default="")
    _own: OwnSystem | None = PrivateAttr(default=None)

    @field_validator("compare")
    @classmethod
    def _known(cls, compare: dict[str, Published] | None) -> dict[str, Published] | None:
        for name in compare or {}:
            if name not in ANALYSES:
                raise rule(f"unknown analysis{close_match(name, ANALYSES)}; known are {', '.join(ANALYSES)}", name)
        return compare

    @model_validator(mode="after")
    def _check(self) -> Experiment:
        self.initial.check(self.system, self.sweep)
        solver = self.accuracy.solver
        if solver and solver not in RUNGE_KUTTA and not isinstance(self.system, PrescribedSpeed):
            general = ", ".join(RUNGE_KUTTA)
            raise rule(f"{solver} is for a particle at a prescribed speed; others are {general}", "accuracy.solver")
        options = getattr(self.analyses, "lyapunov", None)
        most = self.system.exponents(self.sweep)
        if options is not None and "exponents" in options.model_fields_set and options.exponents > most:
            raise rule(f"must be at most {most}, not {options.exponents}", "analyses.lyapunov.exponents")
        if self.accuracy.precision == "float32" and not isinstance(self.system, PrescribedSpeed):
            raise rule("float32 is for a particle at a prescribed speed", "accuracy.precision")
        for analysis, _ in self.requested():
            if self.accuracy.precision == "float32" and analysis.name in _BY_NEWTON:
                message = f"float32 is too coarse for Newton on orbits, which {analysis.name} rests on"
                raise rule(message, "accuracy.precision")
        self._check_section()
        return self

    def _check_section(self) -> None:
        """See that a section is asked for where there is no clock alone, and what cannot be done there is not."""
        if not self.autonomous:
            if self.section:
                raise rule("this scene has a clock, and is seen at its strobes; leave section out", "section")
            return
        if self.accuracy.precision == "float32":
            raise rule("float32 goes with a strobe, and this scene has no clock", "accuracy.precision")
        fitting = [name for name, s in SPLITTINGS.items() if not s.processed]
        solver = self.accuracy.solver
        if solver and isinstance(self.system, PrescribedSpeed) and solver not in fitting:
            raise rule(
                f"steps end one by one at crossings, which {solver} is not made for; others are {', '.join(fitting)}",
                "accuracy.solver",
            )
        for analysis, options in self.requested():
            if analysis.name not in _ON_SECTIONS:
                message = (
                    f"{analysis.name} is for a scene with a clock, and this one has neither forcing nor disturbance; "
                    f"without them there are {', '.join(_ON_SECTIONS)}"
                )
                raise rule(message, f"analyses.{analysis.name}", "system.without")
            if analysis.name in ("poincare", "diagram") and not getattr(options, "transient", 1):
                message = "must be at least 1: the start state is not on the section"
                raise rule(message, f"analyses.{analysis.name}.transient")
            if getattr(options, "phase", 0.0):
                raise rule("there is no period to have a phase in; leave it out", f"analyses.{analysis.name}.phase")

    @property
    def autonomous(self) -> bool:
        """Whether the scene has no clock: neither forcing nor disturbance."""
        return isinstance(self.system, PlanarSystem) and self.system.build().autonomous

    def system_and_start(self) -> tuple[Any, Any]:
        """The system, without a clock on its section, and its start state."""
        flow = self.system.build()
        start = self.initial.state(flow)
        if not self.autonomous:
            return flow, start
        return (self.section or EventSection()).of(flow), Crossing(start, 0.0, 0.0)

    @property
    def source(self) -> Path:
        """The file this was read from, as the user named it."""
        return self._source

    @property
    def text(self) -> str:
        """The YAML as run: the file's text, with the overrides applied and the comments kept."""
        return self._text

    @property
    def sha256(self) -> str:
        """Hash, in hex, of what decides the numbers.

        It is taken of the validated content in canonical JSON, so that formatting, comments, the order of keys and
        defaults written out do not change it. Nor do `title` and `compare`, which change no number.
        """
        content = self.model_dump(mode="json", exclude={"title", "compare"}, exclude_none=True)
        if self.autonomous:
            content["section"] = (self.section or EventSection()).model_dump(mode="json")
        if self._own:
            content["system"]["file"] = self._own.sha256
        canonical = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(canonical.encode()).hexdigest()

    @property
    def precision(self) -> str:
        """Arithmetic within a period: "float64", or "float32" where it is asked for."""
        return self.accuracy.precision or "float64"

    @property
    def own(self) -> OwnSystem | None:
        """The user's file that the system is from, if it is."""
        return self._own

    def requested(self) -> list[tuple[Analysis, Options]]:
        """The analyses asked for, each with its options, in the order of the config."""
        return self.analyses.requested()


_LAYOUT = Layout(
    models={
        (): Experiment,
        ("initial",): Initial,
        ("sweep",): Sweep,
        ("section",): EventSection,
        ("accuracy",): Accuracy,
        ("analyses",): Analyses,
        **{("analyses", name): analysis.options for name, analysis in ANALYSES.items()},
        **{("compare", name): Published for name in ANALYSES},
    },
    variants={
        ("system",): {"constant_speed": ConstantSpeed, "disturbed_speed": DisturbedSpeed, "free": Free},
        ("sweep", "b"): {"start, stop, count": Evenly, "values": Named},
        ("sweep", "a"): {"start, stop, count": Evenly, "values": Named},
    },
    selectors={("system",): "constraint", ("sweep", "b"): "values", ("sweep", "a"): "values"},
)


def _of_own(own: OwnSystem) -> tuple[type[Experiment], Layout]:
    """The experiment of a user's system: its parameters, coordinates and sweep have the places of the built-in ones."""
    system, initial, sweep = own_sections(own)
    fields: dict[str, Any] = {
        "system": (system, Field(description="The user's file, and the parameters")),
        "initial": (
            initial,
            Field(default_factory=initial, description="Start state at t = 0, the same for all lanes"),
        ),
        "sweep": (sweep, Field(description="The parameter that differs from lane to lane, and its values")),
    }
    model = create_model("OwnExperiment", __base__=Experiment, **fields)
    grids: dict[KeyPath, Any] = {("sweep", name): _LAYOUT.variants["sweep", "b"] for name in own.parameters}
    layout = Layout(
        models={**_LAYOUT.models, (): model, ("system",): system, ("initial",): initial, ("sweep",): sweep},
        variants=grids,
        selectors=dict.fromkeys(grids, "values"),
    )
    return model, layout


def load(path: Path, overrides: Sequence[str] = (), own_text: str | None = None) -> Experiment:
    """Read, override and validate a config.

    Args:
        path: the YAML file.
        overrides: KEY=VALUE, KEY a dotted path into the YAML (a number for an item of a list), VALUE as in YAML.
        own_text: what the user's file says that the config names, in place of reading it.

    Raises:
        ConfigError: one line, `FILE:LINE: KEY: what is wrong`, or `command line: KEY: ...` for an override; of a
            user's system, also `ITS FILE:LINE: what is wrong`.
    """
    source = read(path, overrides)
    model, layout, own = Experiment, _LAYOUT, None
    try:
        named = source.data.get("system")
        if isinstance(named, dict) and isinstance(named.get("file"), str):
            if own_text is None and not (path.parent / named["file"]).is_file():
                raise source.error(("system", "file"), f"there is no file {path.parent / named['file']}")
            own = OwnSystem(path.parent / named["file"], own_text)
            model, layout = _of_own(own)
        experiment = model.model_validate(source.data)
    except ValidationError as error:
        raise first_fault(error, source, layout) from None
    except OwnSystemError as error:
        raise ConfigError(str(error)) from None
    experiment._source, experiment._text, experiment._own = path, source.text, own
    return experiment


def schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a config, with a description for every key: for editors."""
    return {"$schema": GenerateJsonSchema.schema_dialect, **with_own_systems(Experiment.model_json_schema())}
