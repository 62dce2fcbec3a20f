"""Rules that need the flow: on an analysis with flow and sweep, on jumps and switches, and on levels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from jaxnh.analyses.base import Analysis, OptionError, Setting
from jaxnh.analyses.options.base import Options, rule
from jaxnh.analyses.registry import ANALYSES
from jaxnh.config.blocks import Levels
from jaxnh.config.messages import join_words
from jaxnh.config.solver_names import ADAPTIVE, NYSTROM, RUNGE_KUTTA
from jaxnh.systems.flow import Flow
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth


def check_analyses(requested: Sequence[tuple[Analysis, Options]], setting: Setting) -> None:
    """Check that analyses suit the flow, their options flow and sweep, and that no two make the same group.

    Raises:
        ValueError: they do not; the rule names the key.
    """
    for analysis, options in requested:
        _check_analysis(analysis, options, setting)
    for analysis, _ in requested:
        for other, _ in requested:
            if analysis.whole and other is not analysis and other.name in analysis.whole.brings:
                message = f"{analysis.name} makes the group {other.name} itself; leave it out"
                raise rule(message, f"analyses.{other.name}", "analyses")


def _check_analysis(analysis: Analysis, options: Options, setting: Setting) -> None:
    name = analysis.name
    try:
        analysis.check(options, setting)
    except OptionError as error:
        key = f"analyses.{name}.{error.key}".rstrip(".")
        axes = () if error.key in options.model_fields_set else (f"sweep.{axis.name}" for axis in setting.axes)
        raise rule(str(error), key, f"analyses.{name}", *axes) from None


def check_events(flow: Flow, solver: str | None, precision: str) -> None:
    """Check that solver and precision go with a flow that has jumps or switches.

    Raises:
        ValueError: one does not; the rule names the key.
    """
    if not isinstance(flow, PiecewiseSmooth):
        return
    if solver in NYSTROM or (flow.needs_events and solver in ADAPTIVE):
        others = ", ".join(RUNGE_KUTTA)
        raise rule(f"{solver} has no steps that end at jumps or switches; {others} have", "accuracy.solver")
    if precision == "extended":
        raise rule("extended goes with smooth systems, and this one has jumps or switches", "accuracy.precision")


def check_levels(levels: Levels, sizes: Mapping[str, int], requested: Sequence[tuple[Analysis, Options]]) -> None:
    """Check that the coarsest level has two values of every axis, and that lanes can be left out.

    Args:
        levels: what the config says.
        sizes: number of values of each axis.
        requested: the analyses asked for.

    Raises:
        ValueError: they do not; the rule names the key.
    """
    for name, size in sizes.items():
        if 1 < size <= levels.coarsest:
            most = (size - 1).bit_length()
            few = f"{size} values of {name} are too few for {levels.count} levels"
            advice = f"{most} at most, or {levels.coarsest + 1} values" if most > 1 else "leave levels out"
            raise rule(f"{few}: {advice}", "levels.count", f"sweep.{name}")
    for analysis, options in requested:
        if not analysis.independent(options):
            along = f"{analysis.name} runs along all values of {next(iter(sizes))}"
            raise rule(f"{along}, and levels leave some out: run it without them", f"analyses.{analysis.name}")
    if levels.refine == "boundary" and not any(analysis.classes for analysis, _ in requested):
        known = join_words([analysis.name for analysis in ANALYSES.values() if analysis.classes])
        raise rule(f"a boundary is seen in {known}; ask for one of them as well", "levels.refine")
