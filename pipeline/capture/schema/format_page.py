"""Write config/capture_format.md, the page about `capture.yaml`, from its models.

    python -m pipeline.capture.schema.format_page

A test keeps the page in step with the models.
"""

from __future__ import annotations

import inspect
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from pipeline.base.code_digest import ROOT
from pipeline.capture.schema.capture_yaml import Capture

HEAD = """\
# The capture format, `lightstage-capture/1`

<!-- Written by `make schema` from the models in pipeline/capture: change them there. -->

A capture is one folder. `capture.yaml` at its root names everything else; every path in it is relative to the
folder and may not leave it. Nothing is guessed: a key that is missing, unknown or of the wrong type is an error
that names the file, the key, what was expected and what was found. `make captures/tiny/capture.yaml` writes a small
complete example.

- **Space**: right-handed, metres, y up. The surveyed positions in the table of lights define the stage's frame;
  they need to be good to centimetres only. Cameras follow OpenCV: x right, y down, z forward, `X_camera = R X_world
  + t`; `dist` is k1 k2 p1 p2 k3, or of a fisheye k1 k2 k3 k4.
- **Pixels**: the top-left corner of an image is (0, 0), so the centre of the first pixel is (0.5, 0.5), for
  keypoints and corners as well. An image that is d times smaller than the sensor has the sensor's intrinsics
  divided by d.
- **Light**: images are linear in light once the black level is subtracted (or srgb, if they say so); each camera
  has a 3 x 3 colour response of its own, which the chart measures. A light of radiant intensity I gives I / d^2 at
  the distance d.
- **Patterns**: one row per lit light and frame; what is not listed is off, and a frame without a row is dark. A
  frame that lists every light is fully lit. Any order will do: every n-th frame fully lit, one light at a time,
  groups, dark frames between. Lights that can change colour have `intensity_r`, `intensity_g` and `intensity_b` in
  place of `intensity`. LEDs of different colours may have `spectra`, whose factors of the three channels multiply
  intensities; of mean 1 over the lights.
- **Eyes** (optional): eyeballs are separate parts of the template; `template.eyes` lists their vertices. `gaze` says
  where each looks, in the frame of the template at rest: it does not turn with the head. Without `gaze` it is estimated
  from fully lit images.
- **Regions** (optional): `template.regions` names parts of the surface, such as hair and face, by their vertices.
- **Held out**: `splits` names cameras, frames, segments and patterns that no avatar is trained on, for testing and,
  with `validation_...`, for making choices. Where no validation list is given, an eighth of the training frames is
  taken. A pattern is named by any frame that shows it and is held out wherever it returns. Training frames under the
  same light as a partially lit test frame are found, too: `book_patterns.on_leak` says what then, error or warn.

Whether log and images agree is checked from the images: an offset of a few frames, frames missing or twice, dead or
stuck lights, a wrong pattern in a single frame. `book_patterns.on_desync` says what then: error, fix or ignore.
"""


def format_page() -> str:
    """The page as Markdown."""
    return HEAD + "".join(_section("", Capture))


def _section(path: str, model: type[BaseModel]) -> list[str]:
    title = f"`{path}`" if path else "Keys"
    rows, below = [], []
    for name, field in model.model_fields.items():
        inner, key = _models(field.annotation), f"{path}.{name}" if path else name
        default = "" if field.is_required() else f" Optional{_default(field.default)}."
        text = (field.description or "").rstrip(".").replace("|", "\\|")
        rows.append(f"| `{name}` | {_kind(field.annotation)} | {text}.{default} |\n")
        for one in inner:
            label = f"{key} (method {_method(one)})" if len(inner) > 1 else key
            below += _section(label, one)
    about = f"\n{inspect.cleandoc(model.__doc__ or '')}\n" if path else ""
    return [f"\n## {title}\n{about}\n| key | type | meaning |\n|---|---|---|\n", *rows, *below]


def _models(annotation: Any) -> list[type[BaseModel]]:
    """Models within an annotation: of a section, of a choice of sections, of a list."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]


def _method(model: type[BaseModel]) -> str:
    return str(get_args(model.model_fields["method"].annotation)[0])


def _kind(annotation: Any) -> str:
    """The type in a word or two."""
    if _models(annotation):
        return "list of sections" if "list" in str(annotation) else "section"
    if get_origin(annotation) is Annotated:
        return _kind(get_args(annotation)[0])
    if get_origin(annotation) is Literal:
        return " or ".join(f"`{choice}`" for choice in get_args(annotation))
    if get_origin(annotation) in (Union, UnionType):
        return " or ".join(_kind(part) for part in get_args(annotation) if part is not type(None))
    if get_origin(annotation) is list:
        return f"list of {_kind(get_args(annotation)[0])}s"
    if get_origin(annotation) is dict:
        return f"section of {_kind(get_args(annotation)[1])}s"
    return {str: "text", int: "whole number", float: "number", bool: "true or false"}[annotation]


def _default(value: Any) -> str:
    if value is None or value == []:
        return ""
    told = str(value).lower() if isinstance(value, str | bool) else f"{value:g}"
    return f", {value if isinstance(value, str) else told} if left out"


def main() -> None:
    """Write the page."""
    (ROOT / "config/capture_format.md").write_text(format_page())


if __name__ == "__main__":
    main()
