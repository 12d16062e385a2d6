"""Steps that use every control of the viewer's page once, by mouse, keys, fingers and files."""

from __future__ import annotations

from dataclasses import dataclass

from playwright.sync_api import Page

from docs.generate.page_gestures import (
    Step,
    click,
    drag,
    dropped,
    held,
    measured,
    opened,
    pick,
    played,
    press,
    refused,
    slide,
    touched,
    wheel,
)

LAYERS = ("picture", "albedo", "normals", "diffuse light", "specular light", "shadow", "bounced light")
MOST_LAMPS = 8

OFFERED = """({
  cameras: [...new Set(scene.facts.captured.map(one => one.camera))],
  sliders: scene.facts.sliders.map(one => [one.name, one.farthest]), frames: scene.facts.timeline,
})"""


@dataclass(frozen=True)
class Offered:
    """Controls that not every page has.

    Attributes:
        cameras: whose captured pictures can be shown.
        sliders: of a head, name and where each ends.
        frames: on the timeline.
    """

    cameras: list[str]
    sliders: list[tuple[str, float]]
    frames: int


def desk_steps(page: Page) -> list[Step]:
    """Every control at a desk."""
    offered = Offered(**page.evaluate(OFFERED))
    return [
        *view_steps(), *time_steps(offered), *stage_steps(), *lamp_steps(), *sky_steps(), *picture_steps(offered),
        *head_steps(offered),
        click("Keys", "summary:text('Keys')"), click("About this picture", "summary:text('About')"),
    ]  # fmt: skip


def view_steps() -> list[Step]:
    """The camera."""
    return [
        Step("as it opens", lambda page: None),
        drag("drag turns", "#canvas", (-160, 40)),
        Step("wheel: nearer", wheel),
        drag("Shift and drag moves", "#canvas", (90, 60), "Shift"),
        click("Whole figure", "#home"),
        press("keys: left, +", "#canvas", "ArrowLeft", "ArrowLeft", "+"),
        press("key 0", "#canvas", "0"),
    ]


def time_steps(offered: Offered) -> list[Step]:
    """The timeline, where there is one."""
    if offered.frames < 2:
        return []
    return [slide("timeline", "#frame", "1"), Step("play, stop", played), press("key ,", "#canvas", ",")]


def stage_steps() -> list[Step]:
    """Lights of the stage; in a fully lit frame all of them are those that were captured."""
    return [
        pick("stage: all of them", "#stage-mode", "all", changes=False),
        slide("stage: brightness +1.5", "#stage-gain", "1.5"),
        slide("stage: brightness 0", "#stage-gain", "0"),
        click("one light by name", "#stage-lights button"),
        pick("stage: none", "#stage-mode", "off"),
    ]


def lamp_steps() -> list[Step]:
    """Lamps to drag, up to all eight."""
    return [
        click("Add a lamp", "#add-lamp"),
        drag("drag the lamp", ".handle", (-260, 90)),
        drag("Shift and drag: nearer", ".handle", (0, 60), "Shift"),
        press("lamp by keys", ".handle", "ArrowUp", "ArrowUp", "PageDown"),
        slide("lamp: colour", ".lamp input[type=color]", "#ff3010"),
        slide("lamp: brightness +1", ".lamp input[type=range]", "1"),
        pick("shadow of the lamp", "#layer", "5"),
        pick("layer: picture", "#layer", "0"),
        Step("eight lamps", lambda page: [page.click("#add-lamp") for _ in range(MOST_LAMPS - 1)]),
        Step("removed", lambda page: [page.locator(".lamp button").first.click() for _ in range(MOST_LAMPS)]),
    ]


def sky_steps() -> list[Step]:
    """Panoramas: built in, opened, dropped, and a file that is none."""
    return [
        pick("sky: evening sun", "#sky", "evening"),
        slide("sky: turn", "#sky-turn", "120"),
        slide("sky: brightness -1", "#sky-gain", "-1"),
        Step("sky: not behind", lambda page: page.uncheck("#sky-shown")),
        Step("sky: behind", lambda page: page.check("#sky-shown")),
        pick("sky: overcast", "#sky", "overcast"),
        Step("Open a panorama", opened),
        Step("a file held over it", held),
        Step("panorama dropped", dropped),
        Step("a file that is none", refused),
        pick("sky: none", "#sky", "none"),
    ]


def picture_steps(offered: Offered) -> list[Step]:
    """Exposure, layers, captured pictures, quality, and the time of a picture."""
    layers = [*range(1, len(LAYERS)), 0]
    beside = [pick(f"beside: {camera}", "#beside", camera) for camera in offered.cameras[:1]]
    return [
        slide("exposure +1", "#exposure", "1"),
        slide("exposure 0", "#exposure", "0"),
        *[pick(f"layer: {LAYERS[k]}", "#layer", str(k)) for k in layers],
        *beside,
        *[click("Whole figure", "#home") for _ in beside],
        pick("quality: fast", "#quality", "fast"),
        pick("quality: always full", "#quality", "exact"),
        Step("Measure the frame rate", measured, changes=False),
    ]


def head_steps(offered: Offered) -> list[Step]:
    """Every slider of a head to its end and back, then all of them half way together; a body has none."""
    alone, together = [], []
    for k, (name, farthest) in enumerate(offered.sliders):
        control = f"#head-sliders label:nth-child({k + 1}) input"
        alone += [slide(f"{name} to {value:+g}", control, f"{value:g}") for value in (-farthest, farthest)]
        alone.append(slide(f"{name} to 0", control, "0"))
        together.append(slide(f"{name} half way, too", control, f"{farthest / 2:g}"))
    back = [click("Back to the captured frame", "#head-back")] if offered.sliders else []
    return [*alone, *together, *back]


def phone_steps() -> list[Step]:
    """Gestures of fingers on a small screen."""
    return [
        Step("on a phone", lambda page: None),
        Step("one finger turns", lambda page: touched(page, ((120, 250),), ((180, 250),), ((240, 250),))),
        Step("two fingers: nearer", lambda page: touched(page, ((150, 250), (230, 250)), ((120, 250), (260, 250)))),
        click("Add a lamp", "#add-lamp"),
        Step("panel scrolled", lambda page: page.locator("#exposure").scroll_into_view_if_needed()),
    ]
