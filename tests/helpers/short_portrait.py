"""A config that asks little of a user's file: what is wrong with it is seen before anything runs for long."""

from __future__ import annotations


def short_portrait(x: float, rate: float, target: float) -> str:
    """The text of a config of the file own.py beside it: one lane from x, two periods at a value of `rate`."""
    return f"""\
system: {{file: own.py}}
initial: {{x: {x}}}
sweep: {{rate: {{values: [{rate}]}}}}
accuracy: {{target: {target}}}
analyses:
  portrait: {{periods: 2, samples: 8}}
"""
