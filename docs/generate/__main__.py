"""Write all generated pages: `python -m docs.generate`. A test keeps them in step with the code."""

from __future__ import annotations

from docs.generate.pages import PAGES
from pipeline.base.code_digest import ROOT

for name, content in PAGES.items():
    (ROOT / name).write_text(content())
