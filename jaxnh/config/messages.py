"""Faults that pydantic finds in a config, in one line of plain words. The rules themselves are in the models."""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from jaxnh.config.yaml_source import ConfigSource
from jaxnh.config.yaml_tree import KeyPath
from jaxnh.exceptions import ConfigError

_KINDS = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "text",
    "bool_type": "true or false",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a mapping of keys to values",
    "model_type": "a mapping of keys to values",
    "model_attributes_type": "a mapping of keys to values",
    "finite_number": "a finite number",
}
_BOUNDS = {
    "greater_than": ("above", "gt"),
    "greater_than_equal": ("at least", "ge"),
    "less_than": ("below", "lt"),
    "less_than_equal": ("at most", "le"),
}


@dataclass(frozen=True)
class Layout:
    """The models at the places of a config.

    Attributes:
        models: path to the model there.
        variants: path to the models of which one stands there, by their tag. Pydantic puts the tag in its paths.
        selectors: path to the key that decides between the variants.
    """

    models: Mapping[KeyPath, type[BaseModel]]
    variants: Mapping[KeyPath, Mapping[str, type[BaseModel]]]
    selectors: Mapping[KeyPath, str]

    def without_tags(self, location: KeyPath) -> tuple[KeyPath, str | None]:
        """A path of pydantic's as it is in the file, and the tag of the innermost variant on it."""
        for path, models in self.variants.items():
            n = len(path)
            if location[:n] == path and len(location) > n and location[n] in models:
                return path + location[n + 1 :], str(location[n])
        return location, None

    def fields(self, path: KeyPath, tag: str | None) -> Mapping[str, str]:
        """Known keys of the mapping at a path, each with its description."""
        model = self.variants[path][tag] if tag and path in self.variants else self.models.get(path)
        return {name: field.description or "" for name, field in model.model_fields.items()} if model else {}


@dataclass(frozen=True)
class _Finding:
    """One fault: what is wrong, and the keys it may be reported at, several where values do not go together."""

    keys: tuple[KeyPath, ...]
    message: str
    kind: str


def first_fault(error: ValidationError, source: ConfigSource, layout: Layout) -> ConfigError:
    """The fault that comes first in the file, or if the file has none, on the command line."""
    findings = [_finding(detail, layout) for detail in error.errors(include_url=False)]
    # A misspelt key is unknown, and the one that was meant is missing: the first says more.
    misspelt = {finding.keys[0][:-1] for finding in findings if finding.kind == "unknown"}
    findings = [f for f in findings if not (f.kind == "missing" and f.keys[0][:-1] in misspelt)]
    # Pydantic counts items that are wrong as none at all.
    parents = {finding.keys[0][:-1] for finding in findings}
    findings = [f for f in findings if not (f.kind == "short" and f.keys[0] in parents)]
    places = [(source.blame(finding.keys), finding) for finding in findings]
    key, finding = min(places, key=lambda place: source.order(place[0]))
    message = finding.message
    if finding.kind == "unknown" and key != finding.keys[0]:  # an override chose a variant without a key of the file
        message += f"; {'.'.join(map(str, key[:-1]))}={{...}} replaces all of them"
    return source.error(key, message)


def fault_of_rule(rule: PydanticCustomError, source: ConfigSource) -> ConfigError:
    """Return the error of a rule that was broken after the validation; its keys are from the top of the file."""
    context = rule.context or {}
    keys = [tuple(key.split(".")) for key in context["keys"]] or [()]
    return source.error(source.blame(keys), context["message"])


def show_value(value: Any) -> str:
    """A value from a config, short, as it would be written there."""
    match value:
        case None:
            return "nothing"
        case bool():
            return "true" if value else "false"
        case str():
            return f"the text {value if len(value) <= 40 else value[:37] + '...'!r}"
        case int() if value.bit_length() > 64:  # str() refuses the longest
            return "a number of that size"
        case float() if math.isnan(value):
            return ".nan"
        case float() if math.isinf(value):
            return ".inf" if value > 0 else "-.inf"
        case int() | float():
            return repr(value)
        case Mapping():
            return "a mapping"
        case _:
            return "a list"


def join_words(words: Sequence[str]) -> str:
    """Words as a sentence lists them: "a", "a and b", "a, b and c"."""
    return " and ".join((*([", ".join(words[:-1])] if len(words) > 1 else []), *words[-1:]))


def explain_unknown(key: str, known: Collection[str], others: Collection[str] = ()) -> str:
    """Describe what is wrong with a key that is not known; `others` are known where something else has been chosen."""
    return f"unknown key{close_match(key, known) or close_match(key, others)}; {_keys(known)}"


def _keys(known: Collection[str]) -> str:
    return f"known keys are {', '.join(known)}" if len(known) > 1 else f"the only known key is {''.join(known)}"


def close_match(word: object, known: Iterable[str]) -> str:
    """A question to append to a message about an unknown word, or nothing."""
    matches = difflib.get_close_matches(str(word), list(known), n=1)
    return f" (did you mean {matches[0]}?)" if matches else ""


def _finding(detail: ErrorDetails, layout: Layout) -> _Finding:
    """Pydantic's error in words."""
    path, tag = layout.without_tags(detail["loc"])
    value, context = detail["input"], detail.get("ctx", {})
    match detail["type"]:
        case "rule":
            keys = tuple((*path, *key.split(".")) for key in context["keys"]) or (path,)
            return _Finding(keys, context["message"], "rule")
        case "missing":
            about = layout.fields(path[:-1], tag).get(str(path[-1]), "")
            return _Finding((path,), f"this key is missing{about and f' ({about})'}", "missing")
        case "extra_forbidden":
            return _unknown(path, tag, layout)
        case "union_tag_not_found":
            return _no_tag(path, value, layout)
        case "union_tag_invalid":
            known = layout.variants[path]
            selector = layout.selectors[path]
            word = value[selector]
            message = f"must be one of {', '.join(known)}, not {show_value(word)}{close_match(word, known)}"
            return _Finding(((*path, selector),), message, "value")
        case "literal_error":
            return _Finding((path,), f"must be {context['expected']}, not {show_value(value)}", "value")
        case "too_short":
            return _Finding((path,), f"must have at least {context['min_length']} of them, not {len(value)}", "short")
        case "value_error":
            return _Finding((path,), str(context["error"]), "value")
        case "float_type" if isinstance(value, int) and not isinstance(value, bool):
            return _Finding((path,), "this number is too large", "value")
        case "model_type" | "model_attributes_type" if path[:1] == ("sweep",) and len(path) == 2:
            message = f"must be {{start: ..., stop: ..., count: ...}} or {{values: [...]}}, not {show_value(value)}"
            return _Finding((path,), message, "value")
        case kind if kind in _KINDS:
            return _Finding((path,), f"must be {_KINDS[kind]}, not {show_value(value)}", "value")
        case kind if kind in _BOUNDS:
            words, bound = _BOUNDS[kind]
            return _Finding((path,), f"must be {words} {context[bound]:.12g}, not {show_value(value)}", "value")
    return _Finding((path,), detail["msg"], "value")


def _unknown(path: KeyPath, tag: str | None, layout: Layout) -> _Finding:
    """A key that its mapping has no place for, or that belongs to another variant of it."""
    above, key = path[:-1], str(path[-1])
    known = layout.fields(above, tag)
    others = [name for model in layout.variants.get(above, {}).values() for name in model.model_fields]
    if key in others:
        selector = (*above, layout.selectors[above])
        return _Finding((path, selector), f"{key} does not go with {tag}; {_keys(known)}", "unknown")
    return _Finding((path,), explain_unknown(key, known, others), "unknown")


def _no_tag(path: KeyPath, value: Any, layout: Layout) -> _Finding:
    """The key that selects the variant is missing, unless one that is there is a misspelling of it."""
    tag = layout.selectors[path]
    known = {name for model in layout.variants[path].values() for name in model.model_fields}
    for key in value:
        if key not in known and close_match(key, [tag]):
            return _Finding(((*path, key),), f"unknown key{close_match(key, [tag])}", "unknown")
    choice = " or ".join(layout.variants[path])
    return _Finding(((*path, tag),), f"this key is missing; it says which: {choice}", "missing")
