"""Public sets, and which of them state how they are to be scored."""

from __future__ import annotations

DATASETS = (
    "goliath", "becominglit", "humanolat", "openillumination", "olatverse", "faceolat", "ava256", "actorshq",
    "nersemble",
)  # fmt: skip
"""Public sets that import_capture reads."""

WITHOUT_PROTOCOL = {
    "faceolat": "its programs and its data state no split of a capture and no scores, and its paper relights people "
    "from one photograph",
}
"""Sets without a protocol of their own -> why. Each other one has a preset config/presets/set_NAME.yaml."""
