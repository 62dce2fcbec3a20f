"""The JSON Schema of a config, for editors; kept as schema.json beside this file, which `jaxnh.sweep --schema` prints.

`python -m jaxnh.config.schema` writes that file anew after a change of the models, and a test says when.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic.json_schema import GenerateJsonSchema

from jaxnh.config.config import Config, ParticleConfig, UserConfig


def schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a config, with a description for every key: for editors."""
    built_in, users = ParticleConfig.model_json_schema(), UserConfig.model_json_schema()
    properties = {**built_in["properties"]}
    system = properties["system"]
    properties["system"] = {**system, "oneOf": [*system["oneOf"], {"$ref": users["properties"]["system"]["$ref"]}]}
    kinds = {"then": {"properties": {}}, "else": {"properties": {}}}  # which of the two is known from the system
    for name in ("initial", "sweep", "section", "accuracy"):
        properties[name] = {"description": properties[name]["description"]}
        for word, given in (("then", users), ("else", built_in)):
            form = given["properties"][name]
            kinds[word]["properties"][name] = {key: form[key] for key in ("$ref", "anyOf") if key in form}
    return {
        "$schema": GenerateJsonSchema.schema_dialect,
        **built_in,
        "description": Config.__doc__,
        "$defs": {**built_in["$defs"], **users["$defs"]},
        "properties": properties,
        "if": {"required": ["system"], "properties": {"system": {"required": ["file"]}}},
        **kinds,
    }


def text() -> str:
    """The schema as the file has it."""
    return json.dumps(schema(), indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    Path(__file__).with_name("schema.json").write_text(text(), encoding="utf-8")
