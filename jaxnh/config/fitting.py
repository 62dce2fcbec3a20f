"""Rules on which accuracy goes with which systems and analyses."""

from __future__ import annotations

from collections.abc import Mapping

from jaxnh.analyses.options import OPTIONS
from jaxnh.analyses.options.base import Options, rule
from jaxnh.config.blocks import Accuracy
from jaxnh.config.messages import join_words
from jaxnh.config.solver_names import ADAPTIVE, NYSTROM, PROCESSED, RUNGE_KUTTA, SPLITTINGS


def check_map_accuracy(accuracy: Accuracy) -> None:
    """Check that a map, which has no steps, is asked for none.

    Raises:
        ValueError: it is; the rule names the key.
    """
    for name in ("target", "solver", "steps"):
        if name in accuracy.model_fields_set and getattr(accuracy, name) is not None:
            raise rule(f"a map is iterated as it is, exact to rounding; leave {name} out", f"accuracy.{name}")


def check_accuracy(accuracy: Accuracy, requested: Mapping[str, Options], *, prescribed: bool, clock: bool) -> None:
    """Check that solver and precision go with the system and the analyses.

    Args:
        accuracy: what the config says.
        requested: options of the analyses asked for, by name.
        prescribed: whether the system is a particle at a prescribed speed.
        clock: whether the scene has one.

    Raises:
        ValueError: they do not; the rule names the key.
    """
    solver, precision = accuracy.solver, accuracy.precision or "float64"
    if solver in SPLITTINGS and not prescribed:
        general = ", ".join((*RUNGE_KUTTA, *NYSTROM, *ADAPTIVE))
        raise rule(f"{solver} is for a particle at a prescribed speed; others are {general}", "accuracy.solver")
    if solver in NYSTROM and prescribed:
        raise rule(f"{solver} is for flows x'' = F(x, t) - gamma x', and this particle is none", "accuracy.solver")
    at_crossings = [name for name in SPLITTINGS if name not in PROCESSED]
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
    if precision == "extended" and not any(options.extended for options in requested.values()):
        known = join_words([name for name, options in OPTIONS.items() if options.extended])
        raise rule(f"extended is for {known}; ask for it as well, or leave this out", "accuracy.precision")
    for name, options in requested.items():
        if precision == "float32" and options.newton:
            raise rule(f"float32 is too coarse for Newton on orbits, which {name} rests on", "accuracy.precision")
