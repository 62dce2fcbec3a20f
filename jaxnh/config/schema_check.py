"""What a config's schema refuses, said before JAX is imported, which takes seconds. The models know the rest.

A value is looked at where the schema has one form for it: unknown keys, wrong types, numbers out of bounds; also keys
that a user's file does not name, where its text says which it does. Which keys go with which constraint, and what goes
together, is left to the models.
"""

from __future__ import annotations

import json
import math
import operator
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from jaxnh.config.messages import not_a, not_one_of, not_within, unknown
from jaxnh.config.user_names import Names
from jaxnh.config.yaml_source import ConfigSource
from jaxnh.config.yaml_tree import KeyPath

SCHEMA = Path(__file__).with_name("schema.json")

_LARGEST = 2.0**53  # beyond, the models tell numbers that are too large
_TYPES = {
    "object": (Mapping, "dict_type"),
    "string": (str, "string_type"),
    "boolean": (bool, "bool_type"),
    "integer": (int, "int_type"),
    "number": (int | float, "float_type"),
}
_BOUNDS = {
    "exclusiveMinimum": ("greater_than", operator.gt),
    "minimum": ("greater_than_equal", operator.ge),
    "exclusiveMaximum": ("less_than", operator.lt),
    "maximum": ("less_than_equal", operator.le),
}


def check_by_schema(source: ConfigSource, names: Names | None = None) -> None:
    """See that a config has no key and no value that its schema refuses.

    Args:
        source: the config.
        names: of its user's file.

    Raises:
        ConfigError: it has; the first in the file, in the words of the models.
    """
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    system = source.data.get("system")
    if not isinstance(system, Mapping):
        return
    chosen = schema["then" if "file" in system else "else"]["properties"]
    if isinstance(system.get("file"), str):
        chosen = {**chosen, "system": {"$ref": "#/$defs/UserSystem"}}
    root = {**schema, "properties": {**schema["properties"], **chosen}}
    found = [*_faults(root, source.data, (), schema["$defs"]), *_unnamed(source.data, names or Names())]
    faults = [(source.blame([path]), message) for path, message in found]
    if faults:
        path, message = min(faults, key=lambda fault: source.order(fault[0]))
        raise source.error(path, message)


def _faults(
    node: Mapping[str, Any], value: Any, path: KeyPath, models: Mapping[str, Any]
) -> Iterator[tuple[KeyPath, str]]:
    """What is wrong with a value of which a node of the schema is, and with those in it."""
    form = _form(node, value, models)
    if form is None:
        return
    if message := _wrong(form, value):
        yield path, message
    elif isinstance(value, Mapping):
        known, others = form.get("properties", {}), form.get("additionalProperties", True)
        for key, content in value.items():
            if key in known:
                yield from _faults(known[key], content, (*path, key), models)
            elif isinstance(others, Mapping):
                yield from _faults(others, content, (*path, key), models)
            elif known and not others:
                yield (*path, key), unknown(str(key), known)


def _unnamed(data: Mapping[str, Any], names: Names) -> Iterator[tuple[KeyPath, str]]:
    """Keys that a user's file does not name."""
    parameters, states = names
    known = {
        "system": parameters is not None and ("file", *parameters),
        "initial": states and ("project", *states),
        "sweep": parameters is not None and states and (*parameters, *states),
    }
    for block, there in known.items():
        given = data.get(block)
        for key in given if there and isinstance(given, Mapping) else ():
            if key not in there:
                yield (block, key), unknown(str(key), there)


def _form(node: Mapping[str, Any], value: Any, models: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The one form that a value can have by a node; None where it is none that is told from the value alone."""
    if "$ref" in node:
        return _form(models[node["$ref"].rpartition("/")[2]], value, models)
    forms = node.get("anyOf") or node.get("oneOf")
    if forms is None:
        return node
    if "enum" in node or (value is None and {"type": "null"} in forms):
        return None
    forms = [form for form in forms if form != {"type": "null"}]
    if len(forms) == 1:
        return _form(forms[0], value, models)
    fitting = [form for each in forms if (form := _form(each, value, models)) and _has_keys_of(form, value)]
    return fitting[0] if len(fitting) == 1 else None


def _has_keys_of(form: Mapping[str, Any], value: Any) -> bool:
    """Whether a form of a mapping has place for all keys of a value, and these are all that it asks for."""
    if form.get("type") != "object" or not isinstance(value, Mapping):
        return False
    tags = {key: content["const"] for key, content in form["properties"].items() if "const" in content}
    return set(form.get("required", ())) <= value.keys() <= form["properties"].keys() and all(
        value.get(key) == tag for key, tag in tags.items()
    )


def _wrong(form: Mapping[str, Any], value: Any) -> str:
    """What is wrong with the value itself, not with what is in it; "" where nothing is, or the models say it."""
    if "enum" in form:
        return "" if value in form["enum"] else not_one_of(form["enum"], value)
    kind = form.get("type")
    if kind not in _TYPES or (kind == "object" and value is None):
        return ""
    types, name = _TYPES[kind]
    if not isinstance(value, types) or (isinstance(value, bool) and kind != "boolean"):
        return not_a(name, value)
    if not isinstance(value, int | float) or abs(value) > _LARGEST or math.isnan(value):
        return ""
    for key, (word, keeps) in _BOUNDS.items():
        if key in form and not keeps(value, form[key]):
            return not_within(word, form[key], value)
    return ""
