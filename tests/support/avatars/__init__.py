"""Small avatars: a `sheet` and its `sheet_subject` in files, `eyeballs`, `heads`, `variants`, a `splat_viewer`."""
