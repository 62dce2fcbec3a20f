"""What goes with what: accuracy with system and analyses, an analysis with scene and sweep, levels with both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from jaxnh.analyses import ANALYSES
from jaxnh.analyses.base import Analysis, OptionError, Options, Setting, rule
from jaxnh.config.blocks import Accuracy, Levels
from jaxnh.config.messages import listed
from jaxnh.solvers import NYSTROM, RUNGE_KUTTA, SPLITTINGS

Requested = Sequence[tuple[Analysis, Options]]
"""Analyses and their options."""


def check_accuracy(accuracy: Accuracy, requested: Requested, *, prescribed: bool, clock: bool) -> None:
    """See that solver and precision go with the system.

    Args:
        accuracy: what the config says.
        requested: the analyses asked for.
        prescribed: whether the system is a particle at a prescribed speed.
        clock: whether the scene has one.

    Raises:
        ValueError: they do not; the rule names the key.
    """
    solver, precision = accuracy.solver, accuracy.precision or "float64"
    if solver in SPLITTINGS and not prescribed:
        general = ", ".join((*RUNGE_KUTTA, *NYSTROM))
        raise rule(f"{solver} is for a particle at a prescribed speed; others are {general}", "accuracy.solver")
    if solver in NYSTROM and prescribed:
        raise rule(f"{solver} is for flows x'' = F(x, t) - gamma x', and this particle is none", "accuracy.solver")
    at_crossings = [name for name, s in SPLITTINGS.items() if not s.processed]
    if solver and prescribed and not clock and solver not in at_crossings:
        others = ", ".join(at_crossings)
        wrong = f"steps end one by one at crossings, which {solver} is not made for; others are {others}"
        raise rule(wrong, "accuracy.solver")
    if precision == "float64":
        return
    if precision == "float32" and not prescribed:
        raise rule(f"{precision} is for a particle at a prescribed speed", "accuracy.precision")
    if not clock:
        raise rule(f"{precision} goes with a strobe, and this scene has no clock", "accuracy.precision")
    if precision == "extended" and not any(analysis.extended for analysis, _ in requested):
        known = listed([analysis.name for analysis in ANALYSES.values() if analysis.extended])
        raise rule(f"extended is for {known}; ask for it as well, or leave this out", "accuracy.precision")


def check_analysis(analysis: Analysis, options: Options, setting: Setting) -> None:
    """See that an analysis can do with the scene, and its options with scene and sweep.

    Raises:
        ValueError: as of `check_accuracy`.
    """
    name = analysis.name
    if setting.precision == "float32" and analysis.newton:
        raise rule(f"float32 is too coarse for Newton on orbits, which {name} rests on", "accuracy.precision")
    try:
        analysis.check(options, setting)
    except OptionError as error:
        key = f"analyses.{name}.{error.key}".rstrip(".")
        axes = () if error.key in options.model_fields_set else (f"sweep.{axis.name}" for axis in setting.axes)
        raise rule(str(error), key, f"analyses.{name}", *axes) from None


def check_levels(levels: Levels, sizes: Mapping[str, int], requested: Requested) -> None:
    """See that the coarsest level has two values of every axis, and that lanes can be left out.

    Args:
        levels: what the config says.
        sizes: number of values of each axis.
        requested: the analyses asked for.

    Raises:
        ValueError: as of `check_accuracy`.
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
        known = listed([analysis.name for analysis in ANALYSES.values() if analysis.classes])
        raise rule(f"a boundary is seen in {known}; ask for one of them as well", "levels.refine")
