"""Reading `capture.yaml`: every key checked, every complaint in a person's words.

Sections that are valid are kept even if others are not, so that what they name is checked in the same run.
"""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError, create_model
from pydantic.fields import FieldInfo

from pipeline.base.errors import Complaints, InputError
from pipeline.base.yaml_files import read_yaml
from pipeline.capture.schema.capture_yaml import Calibration, Capture, Section

MANIFEST = "capture.yaml"

YAML_TYPES = {dict: "a section", list: "a list", str: "text", bool: "true/false", int: "a number", float: "a number"}
EXPECTED_TYPES = {
    "int_type": "a whole number",
    "float_type": "a number",
    "string_type": "text (quote a number or yes/no that is meant as text)",
    "bool_type": "true or false",
    "list_type": "a list",
    "model_type": "a section of keys",
    "model_attributes_type": "a section of keys",
}


def read_manifest(root: Path, complaints: Complaints) -> Capture:
    """Read a capture's description; a section with a complaint is None.

    Sections are `images`, `calibration.lights`, ...

    Raises:
        InputError: if the folder or the file is missing or is not YAML: nothing more can be checked then.
    """
    file = root / MANIFEST
    if not root.is_dir():
        raise InputError(f"{root}: expected a capture folder, found {'a file' if root.exists() else 'none'}")
    if not file.is_file():
        raise InputError(
            f"{file}: expected the capture's description, found {'no plain file' if file.exists() else 'none'}"
        )
    content = read_yaml(file)
    if not isinstance(content, dict):
        raise InputError(f"{file}: expected keys such as 'format: lightstage-capture/1', found {_found(content)}")
    try:
        return Capture.model_validate(content)
    except ValidationError as error:
        problems = error.errors(include_url=False)
    for problem in problems:
        _complain(complaints, problem)
    return _valid_sections(content, {problem["loc"][:depth] for problem in problems for depth in (1, 2)})


def _valid_sections(content: dict[str, Any], bad: set[tuple]) -> Capture:
    sections = {name: _section(Capture, content, name) for name in Capture.model_fields if (name,) not in bad}
    absent = dict.fromkeys(Capture.model_fields)
    calibration = content.get("calibration")
    names = [name for name in Calibration.model_fields if ("calibration", name) not in bad]
    parts = {name: _section(Calibration, calibration, name) for name in names if isinstance(calibration, dict)}
    parts = dict.fromkeys(Calibration.model_fields) | parts
    return Capture.model_construct(**(absent | sections | {"calibration": Calibration.model_construct(**parts)}))


def _section(model: type[Section], content: dict[str, Any], name: str) -> Any:
    """One field of a model, validated on its own."""
    field = model.model_fields[name]
    alone = create_model(name, __base__=Section, **{name: (field.annotation, field)})
    return getattr(alone.model_validate({name: content[name]} if name in content else {}), name)


def _complain(complaints: Complaints, problem: dict[str, Any]) -> None:
    """One of pydantic's errors as a complaint."""
    kind, value = problem["type"], problem["input"]
    # Choices of a value's type stand among the keys.
    place = tuple(part for part in problem["loc"] if not (isinstance(part, str) and " " in part))
    model, context = _model_at(place[:-1]), problem.get("ctx", {})
    field = model.model_fields.get(place[-1])
    key, found, hint = _key(place), _found(value), ""
    if kind == "missing":
        expected, found = _description(field), "no such key"
    elif kind in ("extra_forbidden", "invalid_key"):
        close = difflib.get_close_matches(str(place[-1]), model.model_fields, n=1)
        expected, found = f"one of the keys {', '.join(model.model_fields)}", "an unknown key"
        hint = f"did you mean {close[0]}?" if close else "remove it"
    elif kind == "union_tag_not_found":
        methods = [str(get_args(choice.model_fields["method"].annotation)[0]) for choice in get_args(field.annotation)]
        key, expected, found = f"{key}.method", f"one of {', '.join(methods)}", "no such key"
    elif kind == "union_tag_invalid":
        key, expected, found = f"{key}.method", f"one of {context['expected_tags']}", repr(context["tag"])
    elif kind == "string_pattern_mismatch":
        expected = field.description
    elif kind == "literal_error":
        expected = context["expected"]
    elif kind == "value_error":
        expected = str(context["error"])
    else:
        expected = EXPECTED_TYPES.get(kind, problem["msg"].removeprefix("Input should be "))
    if field is not None and not hint and kind == "literal_error":
        hint = (field.json_schema_extra or {}).get("hint", "")
    complaints.add(MANIFEST, key, expected=expected, found=found, hint=hint)


def _model_at(place: tuple) -> type[BaseModel]:
    """Model whose keys stand at a place of the description; a union's tag follows its key."""
    model, rest = Capture, [part for part in place if not isinstance(part, int)]  # a list's entries are alike
    while rest and (field := model.model_fields.get(rest.pop(0))) is not None:
        kinds = _with_arguments(field.annotation)
        models = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
        if len(models) > 1 and rest:
            tag = rest.pop(0)
            models = [kind for kind in models if tag in get_args(kind.model_fields["method"].annotation)]
        if len(models) != 1:
            break
        model = models[0]
    return model


def _with_arguments(annotation: Any) -> list[Any]:
    """An annotation and all that it is made of: A | list[B] is of A, list[B] and B."""
    return [annotation, *(part for argument in get_args(annotation) for part in _with_arguments(argument))]


def _key(place: tuple) -> str:
    if place[0] == "calibration" and len(place) > 2:
        # After calibration.cameras pydantic names the method that it checked against: no key of the file.
        place = (*place[:2], *place[3:])
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place)[1:]


def _description(field: FieldInfo) -> str:
    kinds = [kind for kind in (field.annotation, *get_args(field.annotation)) if isinstance(kind, type)]
    models = [kind for kind in kinds if issubclass(kind, BaseModel)]
    if len(models) == 1:
        return f"a section with the keys {', '.join(models[0].model_fields)}"
    if models:
        return "a section with a method"
    values = get_args(field.annotation)
    return field.description + (f", one of {', '.join(map(str, values))}" if values and str not in values else "")


def _found(value: object) -> str:
    if value is None:
        return "nothing"
    text = "" if isinstance(value, dict | list) else f" {value!r}"
    return YAML_TYPES.get(type(value), type(value).__name__) + text
