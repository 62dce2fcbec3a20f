"""Keys that a config cannot have, found by its schema before JAX is imported, which takes seconds. The models know all.

A mapping that has one form alone is looked at; which keys go with which constraint, or with a user's file, is left to
the models.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxnh.config.messages import unknown
from jaxnh.config.yaml_source import Source
from jaxnh.config.yaml_tree import KeyPath

SCHEMA = Path(__file__).with_name("schema.json")


def check_keys(source: Source) -> None:
    """See that all keys of a config are known where only one form of a mapping is.

    Raises:
        ConfigError: one is not; in the words of the models.
    """
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    system = source.data.get("system")
    if not isinstance(system, Mapping):
        return
    chosen = schema["then" if "file" in system else "else"]["properties"]
    _check({**schema, "properties": {**schema["properties"], **chosen}}, source.data, (), schema["$defs"], source)


def _check(node: Mapping[str, Any], value: Any, path: KeyPath, models: Mapping[str, Any], source: Source) -> None:
    """See that the keys of a value, and of those in it, are known to a node of the schema."""
    forms = [form for form in node.get("anyOf", ()) if form != {"type": "null"}] or [node]
    if len(forms) > 1 or not isinstance(value, Mapping):
        return
    if "$ref" in forms[0]:
        _check(models[forms[0]["$ref"].rpartition("/")[2]], value, path, models, source)
        return
    known = forms[0].get("properties", {})
    for key, content in value.items():
        if key in known:
            _check(known[key], content, (*path, key), models, source)
        elif known and forms[0].get("additionalProperties") is False:
            raise source.error((*path, key), unknown(str(key), known))
