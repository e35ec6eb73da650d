"""Write the tables of keys in docs/scene.md from the models of a scene file (`mpm.scene`): python docs/make_scene.py"""

import json
from pathlib import Path

from mpm.scene import Scene

PAGE = Path(__file__).with_name("scene.md")
BEGIN, END = "<!-- The tables from here on are written by docs/make_scene.py -->", "<!-- to here. -->"
HEADING = "| key | type | default | range | unit | meaning |\n|---|---|---|---|---|---|\n"
TYPES = {"string": "text", "number": "number", "integer": "whole number", "boolean": "true or false"}
BOUNDS = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}


def updated(page: str) -> str:
    """The text of docs/scene.md with its tables as the models are now."""
    before, rest = page.split(BEGIN)
    return f"{before}{BEGIN}\n\n{_tables(Scene.model_json_schema())}\n{END}{rest.split(END)[1]}"


def _tables(schema: dict) -> str:
    """A heading and a table for each section, the three shapes of a geometry and the walls of a box."""
    models, top = schema["$defs"], dict(schema["properties"])
    parts = [("Before all sections", {"properties": {"name": top.pop("name")}, "required": ["name"]})]
    for name, field in top.items():
        for shape in [arm["$ref"] for arm in field.get("oneOf", [field])]:
            model = models[shape.rpartition("/")[2]]
            kind = model["properties"].get("shape")
            parts.append((f"[{name}]" + (f' with shape = "{kind["const"]}"' if kind else ""), model))
    parts.insert(3, ("geometry.walls of a box", models["Walls"]))
    return "\n".join(_table(title, model) for title, model in parts)


def _table(title: str, model: dict) -> str:
    about = f"{model['description']}\n\n" if "description" in model else ""
    rows = [_row(name, field, name in model.get("required", ())) for name, field in model["properties"].items()]
    return f"### {title}\n\n{about}{HEADING}{''.join(rows)}"


def _row(name: str, field: dict, required: bool) -> str:
    unit = field.get("unit", "")
    arms = [arm for arm in field.get("anyOf", [field]) if arm.get("type") != "null"]
    default = "required" if required else _default(field["default"])
    meaning = field["description"].removesuffix(f" [{unit}]")
    types, ranges = (" or ".join(filter(None, map(of, arms))) for of in (_type, _range))
    return f"| `{name}` | {types} | {default} | {ranges} | {unit} | {meaning} |\n"


def _default(value) -> str:
    if isinstance(value, dict):
        return "see below"
    return "left out" if value is None else f"`{json.dumps(value)}`"


def _type(field: dict) -> str:
    if field.get("type") == "array":
        items = field.get("prefixItems")
        return f"list of {len(items)} {_type(items[0])}s" if items else f"list of {_type(field['items'])}s"
    return "section" if "$ref" in field else TYPES[field["type"]]


def _range(field: dict) -> str:
    if field.get("type") == "array":
        return _range(field.get("items") or field["prefixItems"][0])
    choices = field.get("enum") or ([field["const"]] if "const" in field else [])
    bounds = [f"{sign} {field[word]:g}" for word, sign in BOUNDS.items() if word in field]
    pattern = [f"`{field['pattern']}`"] if "pattern" in field else []
    return ", ".join([*(f"`{json.dumps(choice)}`" for choice in choices), *bounds, *pattern])


if __name__ == "__main__":
    PAGE.write_text(updated(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
