"""Why a lane has ended: the numbers that states and results have for it. What leaves them in states is in `state`."""

from __future__ import annotations

STATUS = (
    "ok",
    "singular",
    "off_constraint",
    "not_finite",
    "no_return",
    "escaped",
    "chattering",
    "codimension_two",
    "out_of_steps",
)
"""Status of a lane, by number."""

NOT_FINITE, NO_RETURN = STATUS.index("not_finite"), STATUS.index("no_return")
CHATTERING, CODIMENSION_TWO = STATUS.index("chattering"), STATUS.index("codimension_two")
OUT_OF_STEPS, ESCAPED = STATUS.index("out_of_steps"), STATUS.index("escaped")
