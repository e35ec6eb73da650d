"""What is wrong with a scene file, in words: one line a problem, with key, value, accepted range and unit."""

import difflib
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic_core import ErrorDetails

# An unknown key is taken for a slip of the pen of a known one that is as long but for so many letters, and as like to
# it (`difflib`'s ratio): "poison" is, at 0.92, "basal_friction" for friction_angle is not, at 0.57.
SLIP_LETTERS, SLIP_LIKENESS = 2, 0.8
LONGEST_VALUE = 60  # characters of a rejected value that a message repeats
# Keys of earlier versions, and why they are gone.
RETIRED = {
    "material.apex_memory": "what opens in tension always closes before pressure returns",
    "explicit.pressure_averaging": "pressure is always averaged, as its law is at the nodes of the grid",
}


def explain(error: ErrorDetails, scene: type[BaseModel]) -> str:
    """One problem in one line: key, value, accepted range and unit, or the nearest known key.

    `error`: one of pydantic's `ValidationError.errors()`. `scene`: the model that was validated.
    """
    location = error["loc"]
    key, model, field = _resolve(location, scene)
    if error["type"] == "extra_forbidden" and key in RETIRED:
        return f"{key}: no longer a key, delete it ({RETIRED[key]})"
    if error["type"] == "extra_forbidden":
        known, last = list(model.model_fields), str(location[-1])
        near = _meant(last, known)
        hint = f"did you mean '{near}'?" if near else f"known here: {', '.join(known)}"
        sections = [
            name for name, its in scene.model_fields.items() if last in getattr(its.annotation, "model_fields", ())
        ]
        if sections:
            hint = f"it belongs in [{sections[0]}], as {sections[0]}.{last}"
        return f"{key}: unknown key; {hint}"
    if error["type"] == "missing":
        about = f" ({field.description})" if field is not None and field.description else ""
        return f"{key}: missing, and it has no default{about}"
    if error["type"].startswith("union_tag"):
        return f"{key}.shape: must be 'column', 'box' or 'mesh'"
    accepted = f"must be a section, [{key}]" if error["type"].startswith("model") else _accepted(field, error)
    return f"{key} = {shown(error['input'])}: {accepted}"


def _meant(word: str, known: list[str]) -> str | None:
    """The known key of which `word` is a slip of the pen; None where it may well mean something else.

    A slip changes a letter or two. A key with a word more (basal_friction_angle) is another quantity's.
    """
    alike = [key for key in known if abs(len(key) - len(word)) <= SLIP_LETTERS]
    return next(iter(difflib.get_close_matches(word, alike, n=1, cutoff=SLIP_LIKENESS)), None)


def says_less(error: ErrorDetails) -> bool:
    """Whether this is the 'rest' half of "'rest' or a number": the other half's message names both."""
    return str(error["loc"][-1]).startswith("literal[")


def shown(value) -> str:
    """A rejected value as a message repeats it: short, whatever was in the file."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no integer of more than 4300 digits
        return "(a very long number)"
    return text if len(text) <= LONGEST_VALUE else text[:LONGEST_VALUE] + "..."


def _resolve(location: tuple, scene: type[BaseModel]) -> tuple[str, type[BaseModel], Any]:
    """Dotted key, the model that holds its last part, and that part's field (None if unknown)."""
    model, field, keys = scene, None, []
    for part in location:
        if field is not None and field.discriminator and (arm := _arms(field).get(part)):
            model, field = arm, None
            continue
        if isinstance(part, str) and (part in model.model_fields or field is None):
            keys.append(part)
            field = model.model_fields.get(part)
            inner = getattr(field, "annotation", None)
            if isinstance(inner, type) and issubclass(inner, BaseModel):
                model, field = inner, None if part != location[-1] else field
        elif isinstance(part, int):
            keys.append(str(part))
    return ".".join(key if key.isprintable() else repr(key) for key in keys), model, field


def _arms(field) -> dict[str, type[BaseModel]]:
    """The models of a union that a key tells apart, by that key's value."""
    return {
        word: arm
        for arm in get_args(field.annotation)
        for word in get_args(arm.model_fields[field.discriminator].annotation)
    }


def _accepted(field, error: ErrorDetails) -> str:
    """Accepted type, range or values and unit of a field, in words."""
    kind, unit = error["type"], (getattr(field, "json_schema_extra", None) or {}).get("unit")
    if kind == "string_pattern_mismatch":
        words = "must consist of letters, digits, '.', '_' and '-'"
    elif kind.startswith(("float", "finite", "greater", "less")):
        alternatives, bounds = _choices(field)
        number = "a number " if alternatives or kind.startswith("f") else ""
        words = "must be " + " or ".join([*alternatives, number + " and ".join(bounds)])
    else:
        words = error["msg"].replace("Input should be", "must be").replace("Tuple", "the list").replace("tuple", "list")
        words = words[0].lower() + words[1:]
    return words + (f" [{unit}]" if unit else "")


def _choices(field) -> tuple[list[str], list[str]]:
    """What a number's field takes: words in place of a number ('rest'), and the bounds of the number."""
    arms = get_args(field.annotation)  # the arms of a union, the elements of a tuple
    words = [repr(word) for arm in arms if get_origin(arm) is Literal for word in get_args(arm)]
    marks = list(field.metadata)
    marks += [mark for arm in arms for inner in getattr(arm, "__metadata__", ()) for mark in inner.metadata]
    symbols = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    bounds = [
        f"{symbol} {getattr(mark, name):g}" for mark in marks for name, symbol in symbols.items() if hasattr(mark, name)
    ]
    return words, list(dict.fromkeys(bounds))
