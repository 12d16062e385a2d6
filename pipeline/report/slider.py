"""Two pictures of the same thing, one over the other, with an edge to push.

Pointer and keys push it.

The control is an ordinary range input that covers the pictures. It is wider than they are by its thumb, so that the
edge is exactly where the pointer is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from pipeline.metrics.comparison import ERROR_AT_TOP, PANELS, heat_css

THUMB_REM = 2.5

SLIDER_STYLE = f"""
.sliders {{ display: flex; flex-wrap: wrap; gap: 1rem; }}
.choice {{ border: 0; padding: 0; margin: .4rem 0; display: flex; flex-wrap: wrap; gap: .3rem 1.2rem; }}
.choice legend {{ float: left; margin-right: 1rem; color: var(--muted); }} .choice label {{ cursor: pointer; }}
.choice input {{ accent-color: var(--accent); }}
.slider {{ width: min(100%, calc(min(72vh, 40rem) * var(--shape))); }}
.stack {{ position: relative; overflow: hidden; background: #000; border-radius: .5rem; border: 1px solid var(--line);
  --at: 50%; aspect-ratio: var(--shape); }}
.stack img {{ position: absolute; inset: 0; width: 100%; height: 100%; border: 0; border-radius: 0; visibility: hidden;
  image-rendering: pixelated; background: #000; filter: none; }}
{"".join(f".stack[data-right={name}] .{name}, .stack[data-left={name}] .{name}, " for name in PANELS)}.none {{
  visibility: visible; }}
{"".join(f".stack[data-left={name}] .{name}, " for name in PANELS)}.none {{ z-index: 1;
  clip-path: inset(0 calc(100% - var(--at)) 0 0); }}
.stack::before, .stack::after {{ position: absolute; top: .4rem; z-index: 3; padding: 0 .45rem; border-radius: .3rem;
  background: #000c; color: #fff; font-size: .8rem; pointer-events: none; }}
.stack::before {{ content: attr(data-left); left: .4rem; }} .stack::after {{ content: attr(data-right); right: .4rem; }}
.edge {{ position: absolute; z-index: 2; top: 0; bottom: 0; left: var(--at); width: 2px; margin-left: -1px;
  background: #fff; box-shadow: 0 0 3px #000; pointer-events: none; }}
.edge::after {{ content: "\\2194"; position: absolute; top: 50%; left: 50%; transform: translate(-50%, -50%);
  width: 2rem; height: 2rem; border-radius: 50%; background: #fff; color: #111; text-align: center; line-height: 2rem;
  box-shadow: 0 0 4px #000; }}
.stack input {{ position: absolute; z-index: 4; inset: 0 -{THUMB_REM / 2}rem; width: calc(100% + {THUMB_REM}rem);
  height: 100%; margin: 0; opacity: 0; cursor: ew-resize; touch-action: pan-y; -webkit-appearance: none;
  appearance: none; }}
.stack input::-webkit-slider-thumb {{ -webkit-appearance: none; width: {THUMB_REM}rem; height: 100%; }}
.stack input::-webkit-slider-runnable-track {{ height: 100%; }}
.stack input::-moz-range-thumb {{ width: {THUMB_REM}rem; height: 100%; border: 0; }}
.stack:focus-within {{ outline: 3px solid var(--accent); outline-offset: 2px; }}
.heat {{ display: inline-block; width: 7rem; height: .7rem; margin: 0 .4rem; border-radius: .2rem;
  background: {heat_css()}; }}
"""

SLIDER_SCRIPT = """
for (const stack of document.querySelectorAll('.stack')) {
  const range = stack.querySelector('input');
  const show = () => {
    stack.style.setProperty('--at', range.value + '%');
    range.setAttribute('aria-valuetext',
      range.value + ' % ' + stack.dataset.left + ', ' + (100 - range.value) + ' % ' + stack.dataset.right);
  };
  range.addEventListener('input', show);
  stack.addEventListener('chosen', show);
  show();
}
for (const group of document.querySelectorAll('.compared')) {
  const choose = () => {
    const [left, right] = group.querySelector('.choice input:checked').value.split(' ');
    for (const stack of group.querySelectorAll('.stack')) {
      Object.assign(stack.dataset, {left, right});
      stack.dispatchEvent(new Event('chosen'));
    }
  };
  for (const choice of group.querySelectorAll('.choice input')) choice.addEventListener('change', choose);
  choose();
}
"""
"""Without it the pictures stand half and half. A reload may keep an earlier choice, so it is read once at the start."""

PAIRS = (("captured", "rendered"), ("captured", "error"), ("rendered", "error"))


def slider(pictures: Mapping[str, str], shape: float, caption: str) -> str:
    """One stack of pictures.

    Args:
        pictures: `PANELS` -> URI.
        shape: width over height.
        caption: says what is shown; also the control's name.
    """
    name = escape(caption, quote=True)
    images = "".join(f'<img class="{panel}" src="{pictures[panel]}" alt="{panel}: {name}">' for panel in PANELS)
    return (
        f'<figure class="slider" style="--shape:{shape:.4f}">'
        f'<div class="stack" data-left="{PAIRS[0][0]}" data-right="{PAIRS[0][1]}">{images}<span class="edge"></span>'
        f'<input type="range" min="0" max="100" value="50" step="1" aria-label="edge between the pictures of {name}">'
        f"</div><figcaption>{escape(caption)}</figcaption></figure>"
    )


def compared(name: str, sliders: Sequence[str]) -> str:
    """Sliders with a choice of what is compared, and the scale of the error. `name` must differ between groups."""
    choices = "".join(
        f'<label><input type="radio" name="{escape(name, quote=True)}" value="{left} {right}"'
        f"{' checked' if (left, right) == PAIRS[0] else ''}> {left} | {right}</label>"
        for left, right in PAIRS
    )
    scale = f'<p>error: 0<span class="heat"></span>{ERROR_AT_TOP:g} (mean over the channels, of sRGB in 0 to 1)</p>'
    return (
        f'<div class="compared"><fieldset class="choice"><legend>Compare</legend>{choices}</fieldset>'
        f'<div class="sliders">{"".join(sliders)}</div>{scale}</div>'
    )
